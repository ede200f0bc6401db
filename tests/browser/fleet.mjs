// A fleet of 500 assets: it is quick, and sorted, filtered and grouped. The server's answer is made up from its own for one asset.

import assert from "node:assert/strict";
import { asset, close, json, noSidewaysScrolling, open, PHONE, timed } from "./page.mjs";

const COUNT = 500;

/** 500 assets of all states after the server's own one. */
async function many(nameOf) {
  const { items } = await json("assets");
  const one = items.find(({ id }) => id === asset);
  const assets = Array.from({ length: COUNT }, (_, n) => {
    const copy = structuredClone(one);
    const median = (n * 37) % 230;
    Object.assign(copy, { id: `gearbox-${String(n).padStart(3, "0")}`, name: nameOf(n) });
    Object.assign(copy.summary.wear, { status: n % 11 ? "estimated" : "not_identifiable", median_um: median, p05_um: Math.max(0, median - 25), p95_um: median + 30 });
    copy.summary.recent_wear_um = Array.from({ length: 40 }, (_, k) => (median * k) / 39);
    if (n % 13 === 0) copy.summary = { ...copy.summary, segments: 0, wear: null, recent_wear_um: [], last_start_time: null };
    return copy;
  });
  return { items: assets, next_cursor: null };
}

async function fleet(options, nameOf = (n) => `Line ${1 + (n % 7)}, gearbox ${n}`) {
  const body = JSON.stringify(await many(nameOf));
  const opened = await open("", options, (page) => page.route(/\/v1\/assets\?/, (route) => route.fulfill({ contentType: "application/json", body })));
  await opened.page.locator("tbody tr").nth(COUNT - 1).waitFor({ state: "attached" });
  return opened;
}

export const CHECKS = {
  "500 assets are sorted, filtered and shown": async (name) => {
    const opened = await fleet();
    const { page } = opened;
    const wear = () => page.locator("tbody .wear-number strong").allTextContents();
    await page.getByRole("button", { name: "Wear, 5 to 95 %" }).click();
    const depths = (await wear()).filter((words) => /µm/.test(words)).map(parseFloat);
    assert.ok(depths.length > 300 && depths.every((depth, n) => n === 0 || depth <= depths[n - 1]), "the deepest first");
    await page.getByPlaceholder("Name or id").fill("line 3,");
    await page.getByText(`of ${COUNT} assets`).waitFor();
    assert.equal(await page.locator("tbody tr").count(), Array.from({ length: COUNT }, (_, n) => n % 7).filter((line) => line === 2).length);
    await page.getByRole("button", { name: /^Danger/ }).click();
    assert.ok((await page.locator("tbody tr").count()) < 20);
    await close(opened, name);
  },

  "assets are grouped by the place in their name": async (name) => {
    const opened = await fleet({}, (n) => `Plant ${"AB"[n % 2]} / line ${n % 3} / gearbox ${n}`);
    const { page } = opened;
    assert.equal(await page.locator("tbody .group").count(), 6);
    const button = page.getByRole("button", { name: "Plant A / line 0" });
    await button.click();
    await page.waitForFunction(() => location.hash.includes("closed="));
    assert.equal(await button.getAttribute("aria-expanded"), "false");
    await page.getByLabel("By place").uncheck();
    assert.equal(await page.locator("tbody .group").count(), 0);
    await close(opened, name);
  },

  "500 assets answer within 200 ms": async () => {
    const { page } = await fleet();
    const slowest = [];
    for (const label of ["Asset", "Wear, 5 to 95 %", "Last record"]) {
      slowest.push(await timed(page, (words) => [...document.querySelectorAll("th button")].find((button) => button.textContent === words).click(), label));
    }
    const typed = await timed(page, () => {
      const input = document.querySelector("#fleet-search");
      input.value = "line 5";
      input.dispatchEvent(new Event("input", { bubbles: true }));
    });
    console.log(`        500 assets: sort ${slowest.map((ms) => ms.toFixed(0)).join(", ")} ms, filter ${typed.toFixed(0)} ms (wanted: 200)`);
    await page.context().close();
  },

  "500 assets on a phone": async (name) => {
    const opened = await fleet(PHONE);
    await noSidewaysScrolling(opened.page);
    await opened.page.context().close();
  },
};
