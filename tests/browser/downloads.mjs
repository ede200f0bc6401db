// What is drawn can be taken along: the numbers of every plot as CSV, its picture as PNG.

import assert from "node:assert/strict";
import { asset, close, drawn, json, open } from "./page.mjs";

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
};

async function bytesOf(download) {
  const chunks = [];
  for await (const chunk of await download.createReadStream()) chunks.push(chunk);
  return Buffer.concat(chunks);
}

/** The file that a button of a plot saves, and the name that it gets. */
async function saved(page, kind, words) {
  const button = page.locator(`[data-plot="${kind}"] .save`, { hasText: words });
  const [download] = await Promise.all([page.waitForEvent("download"), button.click()]);
  return { name: download.suggestedFilename(), bytes: await bytesOf(download) };
}

/** A browser lets a page save about ten files before it asks: so many plots of one page. */
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
    const opened = await open(typeof address === "string" ? address : await address());
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
    }
    await close(opened, name);
  },
]);

export const CHECKS = Object.fromEntries(checks);
