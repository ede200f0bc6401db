// A fleet of 500 assets: speed, sorting, filtering and grouping. The server's answer is derived from that for
// one asset.

import assert from "node:assert/strict";
import { asset, close, json, noSidewaysScrolling, open, PHONE, say, shoot, timed } from "./page.mjs";

const COUNT = 500;
const WANTED_MS = 200;

/** 500 assets in all states after the server's own one. */
async function many(nameOf) {
  const { items } = await json("assets");
  const one = items.find(({ id }) => id === asset);
  const assets = Array.from({ length: COUNT }, (_, n) => {
    const copy = structuredClone(one);
    const median = (n * 37) % 230;
    Object.assign(copy, { id: `gearbox-${String(n).padStart(3, "0")}`, name: nameOf(n) });
    Object.assign(copy.summary.wear, {
      status: n % 11 ? "estimated" : "not_identifiable",
      at_least_um: undefined,
      median_um: median,
      low_um: Math.max(0, median - 25),
      high_um: median + 30,
    });
    copy.summary.recent_wear_um = Array.from({ length: 40 }, (_, k) => (median * k) / 39);
    copy.summary.alarms = {
      danger: Number(n % 50 === 7),
      warning: 0,
      unacknowledged: Number(n % 50 === 7),
      shelved: 0,
    };
    if (n % 13 === 0)
      copy.summary = { ...copy.summary, segments: 0, wear: null, recent_wear_um: [], last_start_time: null };
    return copy;
  });
  return { items: assets, next_cursor: null };
}

const total = (page) =>
  page
    .locator("table")
    .getAttribute("aria-rowcount")
    .then((count) => Number(count) - 1);

async function fleet(options, nameOf = (n) => `Line ${1 + (n % 7)}, gearbox ${n}`) {
  const body = JSON.stringify(await many(nameOf));
  const opened = await open("", options, (page) =>
    page.route(/\/v1\/assets\?/, (route) => route.fulfill({ contentType: "application/json", body })),
  );
  await opened.page.getByText(`${COUNT} assets`).waitFor();
  await opened.page.locator("tbody tr[data-asset]").first().waitFor();
  return opened;
}

export const CHECKS = {
  "500 assets are sorted, filtered and shown": async (name) => {
    const opened = await fleet();
    const { page } = opened;
    assert.equal(await total(page), COUNT);
    await page.getByRole("button", { name: "Wear, 90 % interval" }).click();
    const seen = new Map();
    for (let y = 0; seen.size < COUNT; y += 600) {
      assert.ok(y < 200_000, `${seen.size} rows were seen`);
      await page.evaluate(
        (to) =>
          new Promise(
            (resolve) => (scrollTo(0, to), requestAnimationFrame(() => requestAnimationFrame(resolve))),
          ),
        y,
      );
      const rows = await page
        .locator("tbody tr[data-asset]")
        .evaluateAll((all) =>
          all.map((row) => [
            Number(row.ariaRowIndex),
            parseFloat(row.querySelector(".wear-number strong")?.textContent),
          ]),
        );
      assert.ok(rows.length < 60, `${rows.length} rows are in the page`);
      for (const [index, depth] of rows) seen.set(index, depth);
    }
    const depths = [...seen]
      .sort(([a], [b]) => a - b)
      .map(([, depth]) => depth)
      .filter((depth) => !Number.isNaN(depth));
    assert.ok(
      depths.length > 300 && depths.every((depth, n) => n === 0 || depth <= depths[n - 1]),
      "the deepest first",
    );
    await page.getByPlaceholder("Name, id or location").fill("line 3,");
    await page.getByText(`of ${COUNT} assets`).waitFor();
    assert.equal(
      await total(page),
      Array.from({ length: COUNT }, (_, n) => n % 7).filter((line) => line === 2).length,
    );
    await page.getByRole("button", { name: /^Danger \d/ }).click();
    await page.waitForFunction(() => location.hash.includes("state=danger"));
    assert.ok((await total(page)) < 20);
    await close(opened, name);
  },

  "the keyboard walks through 500 assets": async () => {
    const { page, faults } = await fleet();
    await page.getByRole("button", { name: "Asset", exact: false }).first().click();
    await page.locator("tbody th a").first().focus();
    const index = () => page.evaluate(() => Number(document.activeElement.closest("tr")?.ariaRowIndex));
    assert.equal(await index(), 2, "the row after the heading");
    for (let n = 0; n < 30; n++) await page.keyboard.press("Tab");
    assert.equal(await index(), 32);
    for (let n = 0; n < 30; n++) await page.keyboard.press("ArrowDown");
    assert.equal(await index(), 62);
    const inView = () =>
      page.evaluate(() => {
        const { top, bottom } = document.activeElement.getBoundingClientRect();
        return top >= 0 && bottom <= innerHeight;
      });
    assert.ok(await inView());
    await page.keyboard.press("End");
    assert.equal(await index(), COUNT + 1);
    assert.ok(await inView());
    await page.evaluate(() => scrollTo(0, 0));
    await page.locator('tbody tr[aria-rowindex="2"]').waitFor();
    assert.equal(await index(), COUNT + 1, "the focus stays although its row is out of view");
    await page.keyboard.press("Home");
    assert.equal(await index(), 2);
    assert.deepEqual(faults, []);
    await page.context().close();
  },

  "assets are grouped by the location in their name": async (name) => {
    const opened = await fleet({}, (n) =>
      n % 50 ? `Plant ${"AB"[n % 2]} / line ${n % 3} / gearbox ${n}` : `Gearbox ${n}`,
    );
    const { page } = opened;
    assert.equal(await total(page), COUNT + 7, "a heading for each place, and for those without");
    await page.locator("th button").first().click();
    const button = page.getByRole("button", { name: "Plant A / line 0" });
    await button.click();
    await page.waitForFunction(() => location.hash.includes("closed="));
    assert.equal(await button.getAttribute("aria-expanded"), "false");
    assert.ok((await total(page)) < COUNT);
    const nowhere = page.getByRole("button", { name: "No location" });
    for (const is of ["false", "true", "false"]) {
      await nowhere.click();
      assert.equal(await nowhere.getAttribute("aria-expanded"), is);
    }
    assert.equal(await button.getAttribute("aria-expanded"), "false", "both stay closed");
    await page.getByLabel("Group by location").uncheck();
    await page.waitForFunction(() => location.hash.includes("flat=1"));
    assert.equal(await page.locator("tbody .group").count(), 0);
    await close(opened, name);
  },

  "30 assets fit on one screen in compact rows": async (name) => {
    for (const colorScheme of ["light", "dark"]) {
      const opened = await fleet({ viewport: { width: 1440, height: 900 }, colorScheme });
      const { page } = opened;
      const onScreen = () =>
        page.locator("tbody tr[data-asset]").evaluateAll(
          (rows) =>
            rows.filter((row) => {
              const { top, bottom } = row.getBoundingClientRect();
              return top >= 0 && bottom <= innerHeight;
            }).length,
        );
      assert.ok((await onScreen()) >= 30, `${await onScreen()} rows`);
      // compact rows contain the same information as comfortable ones
      const row = page.locator('tr[data-asset="gearbox-057"]');
      await page.getByPlaceholder("Name, id or location").fill("gearbox 57");
      await row.getByText("1 alarm, 1 unacknowledged").waitFor();
      assert.match(
        (await row.locator(".wear-number").textContent()).replaceAll(/\s+/g, " "),
        /39 µm ?14 to 69/,
      );
      await page.getByPlaceholder("Name, id or location").fill("");
      await shoot(page, `${name} ${colorScheme}`);
      await page.getByLabel("Row height").selectOption("high");
      await page.waitForFunction(() => location.hash.includes("rows=high"));
      assert.ok((await onScreen()) < 15, `${await onScreen()} high rows`);
      await close(opened, `${name} ${colorScheme}, high rows`);
    }
  },

  "a compact row cuts off no number, and its title has everything": async (name) => {
    const opened = await fleet({ viewport: { width: 1280, height: 800 } });
    const { page } = opened;
    await page.getByPlaceholder("Name, id or location").fill("gearbox 57");
    const state = page.locator('tr[data-asset="gearbox-057"] td[data-label="State"]');
    await state.getByText("1 alarm", { exact: true }).waitFor();
    const beyond = await state.evaluate((cell) => {
      const { right, bottom } = cell.getBoundingClientRect();
      const shown = [...cell.querySelectorAll(".badge, .alarm-words > span:not(.comma)")]
        .map((part) => part.getBoundingClientRect())
        .filter(({ top }) => top < bottom);
      return { parts: shown.length, cut: shown.filter((part) => part.right > right).length };
    });
    assert.deepEqual(beyond, { parts: 3, cut: 0 }, "state, alarms and unacknowledged ones are in view");
    const title = await state.evaluate((cell) => {
      const { left, top, width, height } = cell.getBoundingClientRect();
      return document.elementFromPoint(left + width / 2, top + height / 2).closest("[title]").title;
    });
    assert.match(title, /1 alarm, 1 unacknowledged/);
    assert.match(title, /Last record: /);
    await close(opened, name);
  },

  "500 assets answer within 200 ms": async () => {
    const { page } = await fleet({ viewport: { width: 1440, height: 900 } });
    for (const label of ["Asset", "Wear, 90 % interval", "Last record"]) {
      const sort = (words) =>
        [...document.querySelectorAll("th button")].find((button) => button.textContent === words).click();
      const times = [];
      for (let turn = 0; turn < 3; turn++) times.push(await timed(page, sort, label));
      say(`500 assets, sorting by “${label}”`, times, WANTED_MS);
    }
    const type = (words) => {
      const input = document.querySelector("#fleet-search");
      input.value = words;
      input.dispatchEvent(new Event("input", { bubbles: true }));
    };
    const [typed, scrolled] = [[], []];
    for (const words of ["line 5", "", "gearbox 4", ""]) typed.push(await timed(page, type, words));
    say("500 assets, filtering", typed, WANTED_MS);
    for (const share of [0.5, 1, 0.2])
      scrolled.push(await timed(page, (to) => scrollTo(0, to * document.body.scrollHeight), share));
    say("500 assets, scrolling", scrolled, WANTED_MS);
    await page.context().close();
  },

  "500 assets on a phone": async (name) => {
    const opened = await fleet(PHONE);
    await noSidewaysScrolling(opened.page);
    const cut = await opened.page
      .locator(".sections")
      .evaluate((sections) => sections.scrollWidth - sections.clientWidth);
    assert.equal(cut, 0, "every section is in view");
    await close(opened, name);
  },
};
