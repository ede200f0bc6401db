// Downloads of plots: their data as CSV, and pictures as PNG, dark on white in either theme, with asset and
// time.

import assert from "node:assert/strict";
import { writeFile } from "node:fs/promises";
import { join } from "node:path";
import {
  asset,
  base,
  close,
  createAsset,
  drawn,
  json,
  open,
  removeAsset,
  shots,
  shownTime,
} from "./page.mjs";
import { sensor } from "./stream.mjs";

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

const RECORDED = ["# Asset: Gearbox in a test (gearbox)", "# Channel: gearbox/x"];

/** Lines expected before the tables of a page. */
const ORIGINS = {
  asset: (kind) =>
    ["wear", "trends"].includes(kind)
      ? [...RECORDED, "# From: 2026-01-01T00:00:00Z"]
      : [...RECORDED, "# Sample rate: 20000 Hz", "# Unit: m/s2"],
  waterfall: () => [...RECORDED, "# From: 2026-01-01T00:00:00Z"],
};

/** Pages whose files have a time in their names. */
const TIMED = ["asset", "bench", "waterfall", "match"];
const TIMES_IN_NAME = /20\d\d-\d\d-\d\d/;

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
 * bottom and in a cursor's colour.
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
    let [white, ink, cursor] = [0, 0, 0];
    for (let at = 0; at < points.length; at += 4) {
      if (is(at, 255, 255, 255, 255)) white += 1;
      if (is(at, 0x7b, 0x3f, 0xc4, 255)) cursor += 1;
      if (at > points.length / 2 && is(at, 0x16, 0x20, 0x2a, 255)) ink += 1;
    }
    return { white: white / (width * height), ink, cursor, corner: Array.from(points.slice(0, 4)) };
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

/** Saves a plot both ways and checks the files; `subject` is the expected caption. */
async function checkSaved(page, kind, subject, where) {
  const csv = await saved(page, kind, "CSV");
  const lines = csv.bytes.toString().trimEnd().split("\r\n");
  const facts = lines.filter((line) => line.startsWith("# "));
  const [head, ...rows] = lines.slice(facts.length);
  assert.match(csv.name, /^[\w.-]+\.csv$/, kind);
  assert.match(facts[0], /^# Plot: \S/, kind);
  assert.ok(
    facts.length > 1 && (ORIGINS[where]?.(kind) ?? []).every((fact) => facts.includes(fact)),
    `${facts}`,
  );
  if (TIMED.includes(where)) assert.match(csv.name, TIMES_IN_NAME, `${kind}: ${csv.name} has a time`);
  assert.match(head, /^"?[a-z][\w. ]*/i, `${kind} has a heading`);
  assert.ok(rows.length >= 3 && rows.every((row) => row.length > 0), `${kind} has ${rows.length} rows`);
  const png = await saved(page, kind, "PNG");
  assert.match(png.name, /^[\w.-]+\.png$/, kind);
  assert.equal(png.bytes.subarray(1, 4).toString(), "PNG", kind);
  assert.ok(png.bytes.readUInt32BE(16) > 600, `${kind}: ${png.bytes.readUInt32BE(16)} px wide`);
  const { white, ink, corner } = await colours(page, png.bytes);
  assert.deepEqual(corner, [255, 255, 255, 255], kind);
  // a waterfall is coloured throughout
  assert.ok(white > (kind === "waterfall" ? 0.1 : 0.5), `${kind}: ${white} of the picture is white`);
  assert.ok(ink > 100, `${kind}: ${ink} points of ink in its lower half`);
  const words = (await page.evaluate("globalThis.written.splice(0)")).join(" ");
  const legend = page.locator(`[data-plot="${kind}"] .legend li`);
  for (const part of [subject, ...(await legend.allTextContents())])
    assert.ok(words.includes(part), `${kind}: “${part}” in “${words}”`);
}

const checks = chunks.map(([key, address, kinds]) => [
  `every plot is saved as numbers and as a picture: ${key}`,
  async (name) => {
    const [where] = key.split(",");
    const opened = await open(address, { colorScheme: "dark" }, listening);
    for (const kind of kinds) {
      await drawn(opened.page, kind);
      await checkSaved(opened.page, kind, await SUBJECTS[where](kind), where);
    }
    await close(opened, name);
  },
]);

export const CHECKS = {
  ...Object.fromEntries(checks),

  "every plot is saved as numbers and as a picture: live": async (name) => {
    const id = await createAsset("saved", {});
    const stop = await sensor(id);
    const opened = await open(`#/assets/${id}/live`, { colorScheme: "dark" }, listening);
    const { page } = opened;
    for (const kind of ["scope", "live-spectrum"]) {
      await drawn(page, kind);
      await checkSaved(page, kind, `${id} · in · 20`, "live");
    }
    await stop();
    await close(opened, name);
    await removeAsset(id);
  },

  "a saved waveform is read again, with its rate and unit": async (name) => {
    const { items } = await json(`assets/${asset}/segments?limit=1&order=desc`);
    const opened = await open(`#/assets/${asset}?show=waveform&part=0~0.05`);
    const { page } = opened;
    await drawn(page, "waveform");
    await page.getByText("every sample").waitFor();
    const { bytes } = await saved(page, "waveform", "CSV");
    const answer = await fetch(`${base}/v1/csv-preview`, {
      method: "POST",
      headers: { "content-type": "text/csv" },
      body: bytes,
    });
    const { columns, sample_rate_hz: rate, fault } = await answer.json();
    assert.equal(fault ?? null, null);
    assert.deepEqual(
      columns.map(({ role }) => role),
      ["time", "channel"],
    );
    assert.equal(columns[1].unit, items[0].unit);
    assert.ok(Math.abs(rate / items[0].sample_rate_hz - 1) < 1e-6, `${rate} Hz`);
    await close(opened, name);
  },

  "a picture shows the lines of a cursor": async (name) => {
    for (const [address, kind, cursor] of [
      [`#/assets/${asset}?show=spectrum`, "spectrum", "cursor=h~400"],
      [`#/assets/${asset}?show=envelope`, "envelope", "ecursor=b&bearing=6205"],
      [`#/assets/${asset}/waterfall?`, "waterfall", "cursor=h~400"],
    ]) {
      const counts = [];
      for (const more of ["", cursor]) {
        const opened = await open(`${address}&${more}`);
        const { page } = opened;
        await drawn(page, kind);
        if (more)
          await page.locator(`[data-plot="${kind}"] .cursor-line`).first().waitFor({ state: "attached" });
        const { bytes } = await saved(page, kind, "PNG");
        if (shots) await writeFile(join(shots, `cursor ${kind} ${more ? "with" : "without"}.png`), bytes);
        counts.push(await colours(page, bytes));
        await close(opened, `${name} ${kind}`);
      }
      const [before, after] = counts;
      assert.ok(after.cursor > before.cursor + 500, `${kind}: ${after.cursor} points of the cursor's colour`);
      // over the opaque waterfall the lines are white
      if (kind === "waterfall")
        assert.ok(after.white > before.white + 0.012, `${before.white} ${after.white}`);
    }
  },
};
