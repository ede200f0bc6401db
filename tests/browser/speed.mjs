// Speed of the pages, measured and printed.

import assert from "node:assert/strict";
import { asset, drawn, json, open, say, seen, timed } from "./page.mjs";

/**
 * Serves a history of 100 000 records, one a minute, derived from the server's own: reduced to 2000 points, or
 * all records of a range.
 */
async function long(page) {
  const begin = Date.UTC(2026, 0, 1);
  const stretch = async (path) => {
    const answer = await json(path);
    const rows = (first, count, minutes) =>
      Array.from({ length: count }, (_, n) => ({
        ...answer.items[Math.floor((n * answer.items.length) / count)],
        start_time: new Date(first + n * minutes * 60_000).toISOString(),
      }));
    return (url) => {
      const { searchParams: asked } = new URL(url);
      if (!asked.has("from"))
        return JSON.stringify({ ...answer, items: rows(begin, 2000, 50), reduced: true });
      const [from, to] = ["from", "to"].map((name) => Date.parse(asked.get(name)));
      const first = Math.max(begin, from);
      const count = Math.max(1, Math.min(100_000, Math.floor((to - first) / 60_000)));
      const most = Math.min(count, Number(asked.get("max_points")));
      return JSON.stringify({ ...answer, items: rows(first, most, count / most), reduced: count > most });
    };
  };
  const [wear, trend] = await Promise.all([
    stretch(`assets/${asset}/wear/history`),
    stretch(`assets/${asset}/indicators?names=rms,kurtosis,omx`),
  ]);
  await page.route("**/wear/history?*", (route) =>
    route.fulfill({ contentType: "application/json", body: wear(route.request().url()) }),
  );
  await page.route("**/indicators?*", (route) =>
    route.fulfill({ contentType: "application/json", body: trend(route.request().url()) }),
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

  "first useful paint of an asset page": async () => {
    const [answers, wears, trends, sizes] = [[], [], [], []];
    for (let turn = 0; turn < 3; turn++) {
      // an empty cache each time
      const { page } = await open(`#/assets/${asset}`);
      // the time in the page, seen by itself: a question asked from here comes late
      const at = (selectors) =>
        page
          .waitForFunction((names) => {
            const isShown = (name) => document.querySelector(name)?.checkVisibility();
            return names.every(isShown) && performance.now();
          }, selectors)
          .then((time) => time.jsonValue());
      const plot = (kind) => `[data-plot="${kind}"] .plot :is(.static, .main-svg)`;
      const times = [[".verdict .badge", ".wear-now strong"], [plot("wear")], [plot("trends")]].map(at);
      const [answer, wear, trend] = await Promise.all(times);
      answers.push(answer);
      wears.push(wear);
      trends.push(trend);
      await page.waitForTimeout(1000);
      sizes.push(
        await page.evaluate(() =>
          ["navigation", "resource"]
            .flatMap((type) => performance.getEntriesByType(type))
            .reduce((sum, { transferSize }) => [sum[0] + 1, sum[1] + transferSize], [0, 0]),
        ),
      );
      await page.context().close();
    }
    say("asset page: verdict and wear on screen, cold", answers, 1000);
    say("asset page: wear plot on screen, cold", wears, 1500);
    say("asset page: trends on screen, cold", trends, 1500);
    console.log(
      `        asset page: ${sizes.map(([count, bytes]) => `${(bytes / 1e3).toFixed(0)} kB in ${count} answers`)[0]}`,
    );
  },

  "the plotting library is fetched when a plot is woken, and once": async () => {
    const { page } = await open("");
    await page.locator(`[data-asset="${asset}"] .badge`).waitFor();
    const fetched = () =>
      page.evaluate(() =>
        performance
          .getEntriesByType("resource")
          .filter(({ name }) => /plotly/.test(name))
          .map(({ transferSize, encodedBodySize: sent, decodedBodySize: whole, duration }) => ({
            transferSize,
            sent,
            whole,
            duration,
          })),
      );
    assert.deepEqual(await fetched(), [], "the fleet does not wait for it");
    await page.goto(`${page.url().split("#")[0]}#/assets/${asset}`);
    await seen(page, "wear");
    const began = Date.now();
    await drawn(page, "wear");
    say("waking the wear plot, cold", [Date.now() - began], 1000);
    const [{ transferSize, sent, whole, duration }] = await fetched();
    const mega = (size) => (size / 1e6).toFixed(1);
    console.log(
      `        plotly.js: ${mega(sent)} MB sent of ${mega(whole)} MB, in ${duration.toFixed(0)} ms`,
    );
    assert.ok(transferSize > 0);
    assert.ok(sent < 0.4 * whole, "it is sent compressed");
    await page.reload();
    await drawn(page, "wear");
    const again = (await fetched()).map((entry) => entry.transferSize);
    assert.deepEqual(again, [0], "a reload takes it from the browser's cache");
    await page.context().close();
  },

  "a trend of 100 000 records": async () => {
    const { page } = await open(`#/assets/${asset}`, {}, long);
    await seen(page, "wear");
    await seen(page, "trends");
    await page.waitForTimeout(1000);
    const redraws = [];
    for (let turn = 0; turn < 3; turn++)
      redraws.push(await timed(page, '() => document.dispatchEvent(new CustomEvent("themechange"))'));
    say("drawing the page's static plots", redraws, 200);
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
