// The table of records: filters, pages, bulk actions, and the link to a record.

import assert from "node:assert/strict";
import {
  close,
  createAsset,
  json,
  minuteTime,
  noSidewaysScrolling,
  open,
  parameters,
  PHONE,
  removeAsset,
  sendNoise,
  sendRecord,
  shoot,
} from "./page.mjs";
import { gearbox } from "./upload.mjs";

const BASELINE = 8;

/** An asset with `records` records of noise on a channel, and some on another one. */
async function recorded(records, others = 0) {
  const id = await createAsset("recorded", { baseline: { records: BASELINE } });
  for (let minute = 0; minute < records; minute++) await sendNoise(id, minute, 1 + 0.01 * minute);
  for (let minute = 0; minute < others; minute++) await sendNoise(id, minute, 2, "a2");
  return id;
}

const rows = (page) => page.locator(".record-table tbody tr");
const box = (page, minute, channel = "a1") =>
  page.getByLabel(
    `Select the record of 2026-03-01 08:${String(minute).padStart(2, "0")}:00 UTC, channel ${channel}`,
  );
const settled = (page, words) => page.locator(".record-pages").getByText(words, { exact: true }).waitFor();

export const CHECKS = {
  "records are listed, filtered, and linked to their page": async (name) => {
    const id = await recorded(12, 2);
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    await settled(page, "1 to 14 of 14 records");
    const first = rows(page).filter({ hasText: "08:11:00" });
    const words = (await first.innerText()).replaceAll(/\s+/g, " ");
    for (const part of [
      "2026-03-01 08:11:00 UTC",
      "a1",
      "0.5 s",
      "4000 Hz",
      "m/s²",
      "No gear pair",
      "yes",
      "Download",
    ])
      assert.ok(words.includes(part), `${part} in ${words}`);
    assert.match(
      await rows(page).filter({ hasText: "08:03:00" }).innerText(),
      /Collecting baseline\s+baseline/,
    );
    await page.locator("#records-channel").selectOption("a2");
    await settled(page, "1 to 2 of 2 records");
    await page.locator("#records-channel").selectOption("");
    await page.locator("#records-status").selectOption("Collecting baseline");
    await settled(page, `1 to ${BASELINE + 2} of ${BASELINE + 2} records`);
    await page.getByLabel("From, UTC").fill("2026-03-01T08:05:00");
    await page.getByLabel("From, UTC").blur();
    await settled(page, "1 to 3 of 3 records");
    assert.equal(parameters(page).get("status"), "collecting_baseline");
    const link = await page.getByRole("link", { name: "Export as MCAP" }).getAttribute("href");
    const { searchParams: exported } = new URL(link);
    assert.deepEqual(Object.fromEntries(exported), {
      status: "collecting_baseline",
      from: "2026-03-01T08:05:00.000Z",
    });
    await page.reload();
    await settled(page, "1 to 3 of 3 records");
    await page.getByRole("link", { name: "2026-03-01 08:06:00 UTC", exact: true }).click();
    await page.locator(".record-bar h2", { hasText: "2026-03-01 08:06:00 UTC" }).waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "an uncertain speed is said in the table": async (name) => {
    const id = await createAsset("doubted", {});
    // a single tone at the mesh frequency, without harmonics
    const samples = Array.from(
      { length: 32_000 },
      (_, n) => Math.sin((2 * Math.PI * 310 * n) / 4000) + 0.01 * Math.sin(n * n),
    );
    await sendRecord(id, { samples });
    const [{ shaft_speed: speed }] = (await json(`assets/${id}/segments`)).items;
    assert.equal(speed.doubt?.reason, "few_harmonics", JSON.stringify(speed));
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    await settled(page, "1 to 1 of 1 record");
    await rows(page)
      .locator('[data-label="Shaft speed"]')
      .getByText(`uncertain: ${speed.harmonics_found} of ${speed.harmonics_sought} mesh harmonics of 31 × `)
      .waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "a record that is not comparable says briefly what it lacks": async (name) => {
    const gear = { teeth: [24, 26], shaft_speed_hz: 16.64 };
    const id = await createAsset("short", { gear, baseline: { records: BASELINE } });
    const samples = Array.from({ length: 20_000 }, (_, n) => gearbox(10_000)(n));
    for (let minute = 0; minute <= BASELINE; minute++) {
      const start_time = minuteTime(minute);
      const cut = minute < BASELINE ? samples.slice(minute) : samples.slice(0, 1000);
      await sendRecord(id, { start_time, sample_rate_hz: 10_000, samples: cut });
    }
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    await rows(page)
      .filter({ hasText: "Not comparable" })
      .locator('[data-label="Status"]')
      .getByText("0.1 s, 0.3 s needed")
      .waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "many records are paged, and the order is reversed": async (name) => {
    const id = await createAsset("paged", {});
    const samples = Array.from({ length: 200 }, (_, n) => Math.sin(n * 0.49));
    const start = (n) => new Date(Date.UTC(2026, 2, 1, 8, 0, n)).toISOString();
    const send = (n) => sendRecord(id, { start_time: start(n), samples });
    for (let n = 0; n < 120; n += 30) await Promise.all(Array.from({ length: 30 }, (_, k) => send(n + k)));
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    await settled(page, "1 to 100 of 120 records");
    await page.getByRole("button", { name: "Next page" }).click();
    await settled(page, "101 to 120 of 120 records");
    assert.equal(await rows(page).count(), 20);
    await page.getByRole("button", { name: "Previous page" }).click();
    await settled(page, "1 to 100 of 120 records");
    await page.locator("#records-order").selectOption("Oldest first");
    await rows(page).first().getByText("08:00:00 UTC").waitFor();
    await page.getByRole("button", { name: "Select all 120" }).click();
    await page.getByText("120 records selected").waitFor();
    await page.getByRole("button", { name: "Exclude", exact: true }).click();
    await page.getByText("120 records excluded. The history is being recomputed.").waitFor();
    await page.locator("#records-status").selectOption("Excluded"); // the history is estimated again in the background
    await settled(page, "1 to 100 of 120 records");
    await close(opened, name);
    await removeAsset(id);
  },

  "records that arrive meanwhile are counted, and not deleted unasked": async (name) => {
    const id = await createAsset("arriving", {});
    const samples = Array.from({ length: 200 }, (_, n) => Math.sin(n * 0.49));
    const start = (n) => new Date(Date.UTC(2026, 2, 1, 8, 0, n)).toISOString();
    const send = (from, to) =>
      Promise.all(
        Array.from({ length: to - from }, (_, k) => sendRecord(id, { start_time: start(from + k), samples })),
      );
    for (let n = 0; n < 105; n += 35) await send(n, n + 35);
    const opened = await open(`#/assets/${id}/records?order=asc`);
    const { page } = opened;
    await settled(page, "1 to 100 of 105 records");
    await send(105, 110); // the first page stays the same
    await settled(page, "1 to 100 of 110 records");
    await page.getByRole("button", { name: "Next page" }).dblclick();
    await settled(page, "101 to 110 of 110 records");
    await page.goBack();
    await settled(page, "1 to 100 of 110 records");
    await page.goForward();
    await settled(page, "101 to 110 of 110 records");
    await page.getByRole("button", { name: "Previous page" }).click();
    await settled(page, "1 to 100 of 110 records");
    await page.getByRole("button", { name: "Select all 110" }).click();
    await page.getByRole("button", { name: "Use as baseline…" }).click();
    await page.getByText("The 110 records from 2026-03-01 08:00:00 UTC").waitFor();
    await send(110, 113);
    await settled(page, "1 to 100 of 113 records");
    await page.getByLabel("Your name").fill("Ada");
    await page.getByRole("button", { name: "Use as baseline", exact: true }).click();
    await page.getByText("Baseline set.").waitFor();
    const { items } = await json(`assets/${id}/maintenance`);
    assert.equal(Date.parse(items[0].until), Date.parse(start(109)) + 1, "as the form said");
    const asked = [];
    page.on("dialog", async (dialog) => {
      asked.push(dialog.message());
      await send(113, 116);
      await dialog.accept();
    });
    await page.getByRole("button", { name: "Delete…" }).click();
    await page.getByText("113 records deleted.").waitFor();
    assert.match(asked[0], /^Delete all 113 records that match\?/);
    await settled(page, "1 to 3 of 3 records");
    await close(opened, name);
    await removeAsset(id);
  },

  "selected records are excluded, included and deleted": async (name) => {
    const id = await recorded(12);
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    await settled(page, "1 to 12 of 12 records");
    assert.ok(await page.getByRole("button", { name: "Delete…" }).isDisabled(), "nothing is selected");
    await box(page, 10).click();
    await box(page, 8).click({ modifiers: ["Shift"] });
    await page.getByText("3 records selected").waitFor();
    await page.getByRole("button", { name: "Exclude", exact: true }).click();
    await page.getByText("3 records excluded.").waitFor();
    await page.locator('[data-excluded="true"]').nth(2).waitFor();
    assert.deepEqual(await page.locator("[data-excluded] .part").allInnerTexts(), [
      "excluded",
      "excluded",
      "excluded",
    ]);
    await shoot(page, `${name} excluded`);
    await page.getByRole("button", { name: "Include" }).click();
    await page.getByText("3 records included.").waitFor();
    await page.locator("[data-excluded]").first().waitFor({ state: "detached" });
    const asked = [];
    page.on("dialog", (dialog) => {
      asked.push(dialog.message());
      return dialog.accept();
    });
    await page.getByRole("button", { name: "Delete…" }).click();
    await page.getByText("3 records deleted.").waitFor();
    await settled(page, "1 to 9 of 9 records");
    assert.match(asked[0], /^Delete 3 records\?/);
    await page.getByText("Select records to change them.").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 9);
    await close(opened, name);
    await removeAsset(id);
  },

  "selected records become the baseline": async (name) => {
    const id = await recorded(20);
    const opened = await open(`#/assets/${id}/records?order=asc`);
    const { page } = opened;
    await settled(page, "1 to 20 of 20 records");
    await box(page, 10).click();
    await box(page, 18).click({ modifiers: ["Shift"] });
    await page.getByRole("button", { name: "Use as baseline…" }).click();
    await page
      .getByText(
        "The 9 records from 2026-03-01 08:10:00 UTC to 2026-03-01 08:18:00 UTC become the healthy baseline",
      )
      .waitFor();
    await page.getByLabel("Your name").fill("");
    await page.getByRole("button", { name: "Use as baseline", exact: true }).click();
    await page.getByText("Enter your name").waitFor();
    await page.getByLabel("Your name").fill("Ada");
    await page.getByRole("button", { name: "Use as baseline", exact: true }).click();
    await page.getByText("Baseline set.").waitFor();
    const { items } = await json(`assets/${id}/maintenance`);
    assert.deepEqual(
      [items[0].kind, items[0].time, items[0].by],
      ["baseline_chosen", "2026-03-01T08:10:00Z", "Ada"],
    );
    await rows(page).filter({ hasText: "08:17:00" }).getByText("Collecting baseline").waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "a raw recording and an MCAP export are downloaded": async () => {
    const id = await recorded(2);
    const { page } = await open(`#/assets/${id}/records`);
    await settled(page, "1 to 2 of 2 records");
    const [raw] = await Promise.all([
      page.waitForEvent("download"),
      rows(page).first().getByRole("link", { name: "Download" }).click(),
    ]);
    assert.match(raw.suggestedFilename(), /^recorded-\d+-a1-2026-03-01T08-01-00Z\.json$/);
    const [mcap] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("link", { name: "Export as MCAP" }).click(),
    ]);
    assert.match(mcap.suggestedFilename(), /\.mcap$/);
    await page.context().close();
    await removeAsset(id);
  },

  "the table on a phone": async (name) => {
    const id = await recorded(3);
    const opened = await open(`#/assets/${id}/records`, PHONE);
    await settled(opened.page, "1 to 3 of 3 records");
    await noSidewaysScrolling(opened.page);
    await box(opened.page, 1).check();
    await opened.page.getByText("1 record selected").waitFor();
    await close(opened, name);
    await removeAsset(id);
  },
};
