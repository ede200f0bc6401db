// Takes the README's pictures from a running `flankwatch demo` whose run is complete:
// FLANKWATCH_URL=http://127.0.0.1:8600 FLANKWATCH_ASSET=demo-gearbox FLANKWATCH_SHOTS=docs/images node tests/browser/pictures.mjs

import { join } from "node:path";
import { asset, base, browser, drawn, json, open, overviewDrawn, shots } from "./page.mjs";

const { items } = await json(`assets/${asset}/segments?limit=1000`);
const worn = items.at(-1).id;
const [early, middle] = [items[Math.floor(items.length / 8)].id, items[Math.floor(items.length / 2)].id];
const page = `#/assets/${asset}`;

/** Additional machines with as many records as the demonstration's, which is not enough for a baseline. */
const FLEET = [
  { id: "gearbox-7", name: "North plant / line 2 / gearbox 7", records: 9 },
  { id: "gearbox-8", name: "North plant / line 2 / gearbox 8", records: 14 },
  { id: "conveyor", name: "South plant / conveyor", records: 0 },
];
const post = (path, type, body) =>
  fetch(`${base}/v1/${path}`, { method: "POST", headers: { "Content-Type": type }, body });
for (const { id, name, records } of FLEET) {
  const gear = { teeth: [24, 26], shaft_speed_hz: 16.64 };
  await post("assets", "application/json", JSON.stringify({ id, name, gear }));
  for (const { id: segment } of items.slice(0, records)) {
    const recording = await fetch(`${base}/v1/segments/${segment}/raw`);
    await post(`assets/${id}/segments`, "application/x-protobuf", await recording.arrayBuffer());
  }
}
const { library_id: library } = (await json(`assets/${asset}`)).summary;

/**
 * A picture: its address, what to wait for, and the part of the page to capture: its height, or an element.
 */
const PICTURES = {
  dashboard: [page, overviewDrawn, 1560],
  fleet: ["#/", (shown) => shown.getByRole("link", { name: "conveyor" }).first().waitFor(), 728],
  library: [`#/libraries/${library}`, plots("grid", "stiffness", "transmission"), 1400],
  alarms: ["#/alarms", (shown) => shown.locator("main tbody tr").first().click(), 660],
  wear: [`${page}/wear`, (shown) => shown.locator('[data-plot="mesh"]').waitFor(), 1176],
  record: [
    `${page}?segment=${worn}&show=spectrum,turn&axis=orders&cursor=s~24~1&zoom=1`,
    plots("spectrum", "turn"),
    [640, 500, 630, 1566],
  ],
  bench: [
    `#/bench?records=${[worn, middle, early].join(",")}&show=spectrum,waveform&axis=orders&scale=db&quantity=velocity`,
    plots("spectrum", "waveform"),
    2400,
  ],
  match: [`${page}/match`, plots("features"), 1525],
  waterfall: [`${page}/waterfall?axis=orders`, plots("waterfall"), 930],
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
