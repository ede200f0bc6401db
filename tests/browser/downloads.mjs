// Downloads of plots: their data as CSV, and pictures as PNG, dark on white in either theme, with asset and
// time.

import assert from "node:assert/strict";
import { asset, close, drawn, json, open, shownTime } from "./page.mjs";

const PAGES = {
  asset: [
    `#/assets/${asset}?show=waveform,spectrum,envelope,turn,cepstrum,posterior`,
    ["wear", "trends", "waveform", "spectrum", "envelope", "turn", "cepstrum", "posterior"],
  ],
  bench: [
    async () => {
      const { items } = await json(`assets/${asset}/segments?limit=2`);
      return `#/bench?records=${items.map(({ id }) => id).join(",")}&show=waveform,spectrum,envelope,turn,cepstrum`;
    },
    ["waveform", "spectrum", "envelope", "turn", "cepstrum"],
  ],
  waterfall: [`#/assets/${asset}/waterfall`, ["waterfall"]],
  match: [`#/assets/${asset}/match`, ["features", "posterior", "stiffness", "transmission"]],
  library: [
    async () => `#/libraries/${(await json("libraries")).items[0].id}`,
    ["grid", "stiffness", "transmission"],
  ],
  preview: [
    `#/assets/${asset}/wear`,
    ["harmonics", "preview-spectrum", "preview-waveform", "stiffness", "transmission"],
  ],
};

const NAME = "Gearbox in a test";

/** The expected captions of a page's pictures. */
const SUBJECTS = {
  asset: async (kind) => {
    const at = async (order) =>
      shownTime((await json(`assets/${asset}/segments?limit=1&order=${order}`)).items[0].start_time);
    const time = ["wear", "trends"].includes(kind)
      ? `${await at("asc")} to ${await at("desc")}`
      : await at("desc");
    return `${NAME} · gearbox/x · ${time}`;
  },
  bench: async () => "2 records overlaid",
  waterfall: () => SUBJECTS.asset("wear"),
  match: () => SUBJECTS.asset("posterior"),
  library: async () => `library ${(await json("libraries")).items[0].id}`,
  preview: async () => `${NAME} · Simulated: `,
};

/** Records the text drawn into pictures. */
const listening = (page) =>
  page.addInitScript(() => {
    const { fillText } = CanvasRenderingContext2D.prototype;
    globalThis.written = [];
    CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
      globalThis.written.push(text);
      return fillText.call(this, text, ...place);
    };
  });

/**
 * The white fraction of a picture, and the number of pixels in the light theme's ink in the plot at its
 * bottom.
 */
const colours = (page, bytes) =>
  page.evaluate(async (data) => {
    const image = new Image();
    image.src = `data:image/png;base64,${data}`;
    await image.decode();
    const { naturalWidth: width, naturalHeight: height } = image;
    const context = new OffscreenCanvas(width, height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data: points } = context.getImageData(0, 0, width, height);
    const is = (at, ...colour) => colour.every((part, n) => Math.abs(points[at + n] - part) < 12);
    let [white, ink] = [0, 0];
    for (let at = 0; at < points.length; at += 4) {
      if (is(at, 255, 255, 255, 255)) white += 1;
      if (at > points.length / 2 && is(at, 0x16, 0x20, 0x2a, 255)) ink += 1;
    }
    return { white: white / (width * height), ink, corner: Array.from(points.slice(0, 4)) };
  }, bytes.toString("base64"));

async function bytesOf(download) {
  const chunks = [];
  for await (const chunk of await download.createReadStream()) chunks.push(chunk);
  return Buffer.concat(chunks);
}

/** The file saved by a plot's button, and its name. */
async function saved(page, kind, words) {
  const button = page.locator(`[data-plot="${kind}"] .save`, { hasText: words });
  const [download] = await Promise.all([page.waitForEvent("download"), button.click()]);
  return { name: download.suggestedFilename(), bytes: await bytesOf(download) };
}

/** Browsers let a page save about ten files before asking: plots per page. */
const PLOTS_A_PAGE = 4;

const chunks = Object.entries(PAGES).flatMap(([key, [address, kinds]]) =>
  Array.from({ length: Math.ceil(kinds.length / PLOTS_A_PAGE) }, (_, n) => [
    n ? `${key}, page ${n + 1}` : key,
    address,
    kinds.slice(n * PLOTS_A_PAGE, (n + 1) * PLOTS_A_PAGE),
  ]),
);

const checks = chunks.map(([key, address, kinds]) => [
  `every plot is saved as numbers and as a picture: ${key}`,
  async (name) => {
    const [where] = key.split(",");
    const opened = await open(
      typeof address === "string" ? address : await address(),
      { colorScheme: "dark" },
      listening,
    );
    for (const kind of kinds) {
      await drawn(opened.page, kind);
      const csv = await saved(opened.page, kind, "CSV");
      const [head, ...rows] = csv.bytes.toString().trimEnd().split("\r\n");
      assert.match(csv.name, /^[\w.-]+\.csv$/, kind);
      assert.match(head, /^"?[a-z][\w. ]*/i, `${kind} has a heading`);
      assert.ok(rows.length >= 3 && rows.every((row) => row.length > 0), `${kind} has ${rows.length} rows`);
      const png = await saved(opened.page, kind, "PNG");
      assert.match(png.name, /^[\w.-]+\.png$/, kind);
      assert.equal(png.bytes.subarray(1, 4).toString(), "PNG", kind);
      assert.ok(png.bytes.readUInt32BE(16) > 600, `${kind}: ${png.bytes.readUInt32BE(16)} px wide`);
      const { white, ink, corner } = await colours(opened.page, png.bytes);
      assert.deepEqual(corner, [255, 255, 255, 255], kind);
      // a waterfall is coloured throughout
      assert.ok(white > (kind === "waterfall" ? 0.1 : 0.5), `${kind}: ${white} of the picture is white`);
      assert.ok(ink > 100, `${kind}: ${ink} points of ink in its lower half`);
      const words = (await opened.page.evaluate("globalThis.written.splice(0)")).join(" ");
      const legend = opened.page.locator(`[data-plot="${kind}"] .legend li`);
      for (const part of [await SUBJECTS[where](kind), ...(await legend.allTextContents())])
        assert.ok(words.includes(part), `${kind}: “${part}” in “${words}”`);
    }
    await close(opened, name);
  },
]);

export const CHECKS = Object.fromEntries(checks);
