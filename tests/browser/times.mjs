// Times in UTC or in the browser's time zone: as text, on axes, and in fields.

import assert from "node:assert/strict";
import {
  asset,
  close,
  createAsset,
  drawn,
  json,
  open,
  parameters,
  removeAsset,
  sendRecord,
  shownTime,
} from "./page.mjs";

const BERLIN = { timezoneId: "Europe/Berlin" };

/** A time as a clock in Berlin shows it. */
const inBerlin = (time) => new Date(time).toLocaleString("sv-SE", { timeZone: "Europe/Berlin" });

export const CHECKS = {
  "times are shown in the browser's time zone if selected": async (name) => {
    const opened = await open(`#/assets/${asset}`, BERLIN);
    const { page } = opened;
    await drawn(page, "wear");
    const { start_time: start } = await json(`assets/${asset}/wear`);
    const heading = page.locator(".record-bar h2");
    await heading.getByText(shownTime(start)).waitFor();
    await page.getByLabel("Times in").selectOption("local");
    await heading.getByText(new RegExp(`${inBerlin(start)} \\+0[12]:00`)).waitFor();
    await drawn(page, "wear");
    const { items } = await json(`assets/${asset}/wear/history?max_points=2000`);
    const axis = await page.evaluate(() => {
      const { data, _fullLayout: layout } = document.querySelector('[data-plot="wear"] .plot');
      const times = data.map(({ x }) => String(x?.[0])).filter((time) => time.startsWith("20"));
      return { title: layout.xaxis.title.text, times };
    });
    assert.equal(axis.title, "Start of record (local time)");
    const first = inBerlin(items[0].start_time).replace(" ", "T");
    assert.ok(
      axis.times.some((time) => time.startsWith(first)),
      `${first} in ${axis.times}`,
    );
    // the choice is stored
    await page.reload();
    await heading.getByText(inBerlin(start)).waitFor();
    assert.equal(await page.getByLabel("Times in").inputValue(), "local");
    await page.getByLabel("Times in").selectOption("utc");
    await heading.getByText(shownTime(start)).waitFor();
    await close(opened, name);
  },

  "a link has the selected time zone": async (name) => {
    const opened = await open(`#/assets/${asset}?trend=rms`, BERLIN);
    const { page } = opened;
    const { start_time: start } = await json(`assets/${asset}/wear`);
    const inUtc = page.locator(".record-bar h2", { hasText: shownTime(start) });
    await inUtc.waitFor();
    assert.equal(parameters(page).get("times"), null, "nothing is selected yet");
    await page.getByLabel("Times in").selectOption("local");
    await page.locator(".record-bar h2", { hasText: inBerlin(start) }).waitFor();
    assert.equal(parameters(page).get("times"), "local");
    // a browser without that choice
    const link = new URL(page.url()).hash;
    const other = await open(link, BERLIN);
    await other.page.locator(".record-bar h2", { hasText: inBerlin(start) }).waitFor();
    assert.equal(await other.page.getByLabel("Times in").inputValue(), "local");
    assert.equal(new URL(other.page.url()).hash, link, "the link stays as it was");
    // other pages follow, and their addresses too
    await other.page.getByRole("link", { name: "Records", exact: true }).click();
    await other.page.getByLabel("From, local time").waitFor();
    assert.equal(parameters(other.page).get("times"), "local");
    await close(other, `${name} restored`);
    // a link in UTC, in a browser that prefers local time
    await page.getByLabel("Times in").selectOption("utc");
    await inUtc.waitFor();
    assert.equal(parameters(page).get("times"), "utc");
    const inUtcLink = new URL(page.url()).hash;
    await page.getByLabel("Times in").selectOption("local");
    await page.locator(".record-bar h2", { hasText: inBerlin(start) }).waitFor();
    await page.goto(`${page.url().split("#")[0]}${inUtcLink}`);
    await inUtc.waitFor();
    assert.equal(await page.getByLabel("Times in").inputValue(), "utc");
    await close(opened, name);
  },

  "a range zoomed in local time is in UTC in the address": async (name) => {
    const opened = await open(`#/assets/${asset}`, BERLIN);
    const { page } = opened;
    await page.getByLabel("Times in").selectOption("local");
    await drawn(page, "wear");
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    await page.mouse.move(area.x + 0.3 * area.width, area.y + 0.5 * area.height);
    await page.mouse.down();
    await page.mouse.move(area.x + 0.6 * area.width, area.y + 0.5 * area.height, { steps: 6 });
    await page.mouse.up();
    await page.waitForFunction(() => location.hash.includes("time="));
    const [from, to] = parameters(page)
      .get("time")
      .split("~")
      .map((time) => Date.parse(time));
    const { items } = await json(`assets/${asset}/wear/history?max_points=2000`);
    const [begin, end] = [items[0], items.at(-1)].map((item) => Date.parse(item.start_time));
    assert.ok(from > begin && from < to && to < end + (end - begin), new Date(from).toISOString());
    await close(opened, name);
  },

  "an entered time is in the selected time zone": async (name) => {
    const opened = await open(`#/assets/${asset}/records`, BERLIN);
    const { page } = opened;
    await page.getByLabel("Times in").selectOption("local");
    const from = page.getByLabel("From, local time");
    await from.fill("2026-07-01T12:00:00");
    await from.press("Enter");
    await page.waitForFunction(() => location.hash.includes("from="));
    assert.equal(parameters(page).get("from"), "2026-07-01T10:00:00.000Z");
    assert.ok((await from.inputValue()).startsWith("2026-07-01T12:00"));
    await close(opened, name);
  },

  "maintenance of a record is at its time, also when the clocks go back": async (name) => {
    const id = await createAsset("clocks", {});
    const samples = Array.from({ length: 2000 }, (_, n) => Math.sin(n * 0.49));
    const [first, second] = ["2025-10-26T00:30:00.25Z", "2025-10-26T01:30:00.25Z"]; // both 02:30 in Berlin
    for (const start of [first, second]) await sendRecord(id, { start_time: start, samples });
    const opened = await open(`#/assets/${id}?times=local`, BERLIN);
    const { page } = opened;
    await page.locator(".record-bar h2", { hasText: "2025-10-26 02:30:00 +01:00" }).waitFor();
    await page.getByRole("button", { name: "Add maintenance…" }).click();
    const dialog = page.getByRole("dialog");
    await dialog.getByLabel("Wear measured").check();
    await dialog.getByLabel("Measured depth (µm)").fill("30");
    assert.match(await dialog.getByLabel("Time, local time").inputValue(), /^2025-10-26T02:30/);
    await dialog.getByLabel("Your name").fill("Ada");
    await dialog.getByRole("button", { name: "Save" }).click();
    await page.locator(".events-card", { hasText: "2025-10-26 02:30:00 +01:00" }).waitFor();
    const [{ time }] = (await json(`assets/${id}/maintenance`)).items;
    assert.equal(Date.parse(time), Date.parse(second));
    await close(opened, name);
    await removeAsset(id);
  },

  "a trend does not run backwards when the clocks go back": async (name) => {
    const id = await createAsset("backwards", {});
    const samples = Array.from({ length: 2000 }, (_, n) => Math.sin(n * 0.49));
    const starts = Array.from({ length: 10 }, (_, n) => new Date(Date.UTC(2025, 9, 25, 23, 20 * n)));
    for (const start of starts) await sendRecord(id, { start_time: start.toISOString(), samples });
    const opened = await open(`#/assets/${id}?times=local&trend=rms`, BERLIN);
    const { page } = opened;
    await page.locator('[data-plot="trends"] .plot').hover();
    await drawn(page, "trends");
    const times = await page.evaluate(() => {
      const { data } = document.querySelector('[data-plot="trends"] .plot');
      return data.map(({ x }) => x).find((x) => x?.length === 10);
    });
    assert.deepEqual(times, [...times].sort());
    // 02:20 in summer time and in winter time share the hour from 02:00
    assert.deepEqual(
      [times[0], times[4], times[7], times[9]].map((time) => time.slice(11, 19)),
      ["01:00:00", "02:10:00", "02:40:00", "03:00:00"],
    );
    await close(opened, name);
    await removeAsset(id);
  },

  "entries outlast the choice of the time zone": async (name) => {
    const opened = await open(`#/assets/${asset}/settings`, BERLIN);
    const { page } = opened;
    await page.getByLabel("Site").fill("North");
    await page.getByLabel("Times in").selectOption("local");
    await page.waitForFunction(() => location.hash.includes("times=local"));
    assert.equal(await page.getByLabel("Site").inputValue(), "North");
    let asked = 0; // whether the unsaved site may be lost
    page.on("dialog", (dialog) => {
      asked += 1;
      return dialog.accept();
    });
    await page.locator('a[href*="/match"]').first().click();
    await page.waitForFunction(() => document.title.includes("Match"));
    assert.equal(asked, 1);
    await page.goto(`${page.url().split("#")[0]}#/assets/${asset}/import`);
    const body = "not a recording";
    await page.setInputFiles("#upload-file", [
      { name: "a.wav", mimeType: "audio/wav", buffer: Buffer.from(body) },
    ]);
    await page.locator(".files > li", { hasText: "a.wav" }).waitFor();
    await page.getByLabel("Times in").selectOption("utc");
    await page.waitForFunction(() => location.hash.includes("times=utc"));
    assert.equal(await page.locator(".files > li", { hasText: "a.wav" }).count(), 1);
    await close(opened, name);
  },
};
