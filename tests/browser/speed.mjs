// Speed of the pages, measured and printed.

import { asset, drawn, json, open, say, timed } from "./page.mjs";

/** Serves a history of 100 000 records reduced to 2000 points, derived from the server's own. */
async function long(page) {
  const stretch = async (path) => {
    const answer = await json(path);
    const rows = Array.from({ length: 2000 }, (_, n) => ({
      ...answer.items[Math.floor((n * answer.items.length) / 2000)],
      start_time: new Date(Date.UTC(2026, 0, 1) + n * 50 * 60_000).toISOString(),
    }));
    return JSON.stringify({ ...answer, items: rows, reduced: true });
  };
  const [wear, trend] = await Promise.all([
    stretch(`assets/${asset}/wear/history`),
    stretch(`assets/${asset}/indicators?names=rms,kurtosis,omx`),
  ]);
  await page.route("**/wear/history?*", (route) =>
    route.fulfill({ contentType: "application/json", body: wear }),
  );
  await page.route("**/indicators?*", (route) =>
    route.fulfill({ contentType: "application/json", body: trend }),
  );
}

/** A waterfall of 600 spectra derived from the server's own. */
async function tall(page) {
  const answer = await json(`assets/${asset}/waterfall?cells=500&max_records=600`);
  const items = Array.from({ length: 600 }, (_, n) => ({
    ...answer.items[n % answer.items.length],
    start_time: new Date(Date.UTC(2026, 0, 1) + n * 60_000).toISOString(),
  }));
  const body = JSON.stringify({ ...answer, items });
  await page.route("**/waterfall?*", (route) => route.fulfill({ contentType: "application/json", body }));
}

const zoom = (kind) => `async () => {
  const plot = document.querySelector('[data-plot="${kind}"] .plot');
  const [low, high] = plot._fullLayout.xaxis.range.map((end) => plot._fullLayout.xaxis.r2l(end));
  const part = (share) => plot._fullLayout.xaxis.l2r(low + share * (high - low));
  await Plotly.relayout(plot, { "xaxis.range": [part(0.2), part(0.7)] });
}`;

export const CHECKS = {
  "first useful paint": async () => {
    const times = [];
    for (let turn = 0; turn < 3; turn++) {
      const { page } = await open("");
      await page.locator(`[data-asset="${asset}"] .badge`).waitFor();
      const painted = await page.evaluate(
        () => performance.getEntriesByName("first-contentful-paint")[0]?.startTime ?? NaN,
      );
      const useful = await page.evaluate(() => performance.now());
      times.push(useful);
      if (turn === 0) console.log(`        first contentful paint: ${painted.toFixed(0)} ms`);
      await page.context().close();
    }
    say("fleet with its rows on screen", times, 1000);
  },

  "a trend of 100 000 records": async () => {
    const { page } = await open(`#/assets/${asset}`, {}, long);
    await drawn(page, "wear");
    await drawn(page, "trends");
    await page.waitForTimeout(1500);
    const zooms = [];
    for (let turn = 0; turn < 3; turn++) zooms.push(await timed(page, zoom("wear")));
    say("zoom of wear and trends together", zooms, 200);
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    const hovers = [];
    for (const share of [0.3, 0.5, 0.7]) {
      const began = Date.now();
      await page.mouse.move(area.x + share * area.width, area.y + area.height / 2);
      await page.evaluate(
        () => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))),
      );
      hovers.push(Date.now() - began);
    }
    say("pointing at a record", hovers, 200);
    await page.context().close();
  },

  "a waterfall of 600 spectra": async () => {
    const { page } = await open(`#/assets/${asset}/waterfall`, {}, tall);
    await drawn(page, "waterfall");
    await page.waitForTimeout(1000);
    const zooms = [];
    for (let turn = 0; turn < 3; turn++) zooms.push(await timed(page, zoom("waterfall")));
    say("zoom", zooms, 200);
    await page.context().close();
  },
};
