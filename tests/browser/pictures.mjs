// Takes the README's pictures from a running `flankwatch demo` whose story is told:
// FLANKWATCH_URL=http://127.0.0.1:8600 FLANKWATCH_ASSET=demo-gearbox FLANKWATCH_SHOTS=docs/images node tests/browser/pictures.mjs

import { join } from "node:path";
import { asset, browser, drawn, json, open, overviewDrawn, shots } from "./page.mjs";

const { items } = await json(`assets/${asset}/segments?limit=1000`);
const worn = items.at(-1).id;
const [early, middle] = [items[Math.floor(items.length / 8)].id, items[Math.floor(items.length / 2)].id];
const page = `#/assets/${asset}`;

/** What is shown in a picture: its address, what has to be there first, and what of the page is kept: its
 * height, or a part of it. */
const PICTURES = {
  dashboard: [page, overviewDrawn, 1560],
  alarms: ["#/alarms", (shown) => shown.locator("main tbody tr").first().click(), 700],
  wear: [`${page}/wear`, (shown) => shown.locator('[data-plot="mesh"]').waitFor(), 1160],
  record: [
    `${page}?segment=${worn}&show=spectrum,turn,cepstrum&axis=orders&cursor=s~24~1&zoom=1`,
    plots("spectrum", "turn", "cepstrum"),
    [640, 500, 630, 1490],
  ],
  bench: [
    `#/bench?records=${[worn, middle, early].join(",")}&show=spectrum,waveform&axis=orders&scale=db&quantity=velocity`,
    plots("spectrum", "waveform"),
    1920,
  ],
  match: [`${page}/match`, plots("features"), 1525],
  waterfall: [`${page}/waterfall?axis=orders`, plots("waterfall"), 960],
  live: [`${page}/live`, plots("scope", "live-spectrum"), 1200],
};

function plots(...kinds) {
  return (shown) => Promise.all(kinds.map((kind) => drawn(shown, kind)));
}

for (const [name, [address, ready, height]] of Object.entries(PICTURES)) {
  const { page: shown } = await open(address);
  await ready(shown);
  await shown.waitForTimeout(2000); // what is drawn last
  const [x, y, width, tall] = Array.isArray(height) ? height : [0, 0, 1280, height];
  const clip = { x, y, width, height: tall };
  await shown.screenshot({ path: join(shots, `${name}.png`), fullPage: true, clip });
  await shown.context().close();
}
await browser.close();
