// Alarms appear automatically and are acknowledged, shelved and commented; maintenance is added and deleted.

import assert from "node:assert/strict";
import {
  asset,
  close,
  counted,
  createAsset,
  drawn,
  json,
  noSidewaysScrolling,
  open,
  parameters,
  PHONE,
  removeAsset,
  sendNoise,
  shoot,
  shownTime,
} from "./page.mjs";

const RULE = {
  quantity: { indicator: "rms" },
  warning: 5,
  danger: 50,
  settings: { raise: 1, raise_of: 1, clear: 1, clear_of: 1 },
};

/** An asset with an RMS alarm raised by noise of the given amplitudes. */
async function alarmed(amplitudes) {
  const id = await createAsset("alarmed", { alarms: [RULE] });
  for (const [minute, amplitude] of amplitudes.entries()) await sendNoise(id, minute, amplitude);
  return id;
}

const alarmOf = async (id) => (await json(`alarms?asset=${id}`)).items[0];
const row = (page, id) => page.locator(".alarms tbody tr", { hasText: id });

export const CHECKS = {
  "an alarm appears automatically, with the number of unacknowledged alarms": async (name) => {
    const opened = await open("#/alarms");
    const { page } = opened;
    await page.locator(".table-card").waitFor();
    const id = await alarmed([1, 20]);
    await row(page, id).waitFor();
    assert.equal(await row(page, id).locator(".badge").innerText(), "Warning");
    await sendNoise(id, 2, 30); // still a warning: the alarm keeps its value
    await page.getByRole("columnheader", { name: "At last change" }).waitFor();
    assert.match(await row(page, id).getByText("14.").innerText(), /^14\.\d m\/s²$/);
    const { items } = await json("alarms?state=unacknowledged,returned_unacknowledged&limit=1000");
    await page.locator("#alarm-number", { hasText: String(items.length) }).waitFor();
    await page.getByRole("link", { name: `Alarms ${items.length} unacknowledged` }).waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "an alarm is acknowledged with a comment, shelved, and unshelved": async (name) => {
    const id = await alarmed([1, 20, 100]);
    const opened = await open(`#/alarms?asset=${id}`);
    const { page } = opened;
    await row(page, id).getByRole("link", { name: "RMS" }).click();
    const detail = page.getByRole("region", { name: "Selected alarm" });
    await detail.getByText("danger raised at").waitFor();
    await detail.getByRole("button", { name: "Acknowledge" }).click();
    await detail.getByText("Enter your name").waitFor();
    await detail.getByLabel("Your name").fill("Ada");
    await detail.getByLabel("Comment", { exact: true }).fill("looked at the flanks");
    await detail.getByRole("button", { name: "Acknowledge" }).click();
    await detail.getByText("Acknowledged.").waitFor();
    assert.ok(await detail.evaluate((panel) => panel.contains(document.activeElement)), "the focus stays");
    await detail.locator(".alarm-history q", { hasText: "looked at the flanks" }).waitFor();
    await row(page, id).waitFor({ state: "detached" });
    const { id: alarm, state } = await alarmOf(id);
    assert.equal(state, "acknowledged");

    await page.getByRole("button", { name: "All", exact: true }).click();
    await row(page, id).waitFor();
    const restored = await open(new URL(page.url()).hash);
    await restored.page
      .getByRole("region", { name: "Selected alarm" })
      .getByText("looked at the flanks")
      .waitFor();
    assert.equal(parameters(restored.page).get("alarm"), alarm);
    await close(restored, `${name} restored`);

    await detail.getByRole("button", { name: "Shelve for" }).click();
    await detail.getByText("Shelved until").first().waitFor();
    assert.ok(Date.parse((await alarmOf(id)).shelved_until) > Date.now());
    await detail.getByRole("button", { name: "Unshelve" }).click();
    await detail.getByText("Unshelved.").waitFor();
    await detail.getByLabel("Comment", { exact: true }).fill("oil changed");
    await detail.getByRole("button", { name: "Comment" }).click();
    await detail.locator(".alarm-history q", { hasText: "oil changed" }).waitFor();
    const { history } = await json(`alarms/${alarm}`);
    assert.deepEqual(
      history.slice(-4).map(({ by }) => by),
      ["Ada", "Ada", "Ada", "Ada"],
    );
    await close(opened, name);
    await removeAsset(id);
  },

  "a second click before the answer does not comment twice": async (name) => {
    const id = await alarmed([1, 20]);
    const { id: alarm } = await alarmOf(id);
    const opened = await open(`#/alarms?asset=${id}&alarm=${alarm}`);
    const { page } = opened;
    const detail = page.getByRole("region", { name: "Selected alarm" });
    await detail.getByLabel("Your name").fill("Ada");
    await detail.getByLabel("Comment", { exact: true }).fill("looked at the flanks");
    await page.route("**/comment", async (route) => {
      await new Promise((done) => setTimeout(done, 300));
      await route.continue();
    });
    await detail.getByRole("button", { name: "Comment", exact: true }).dblclick();
    await detail.getByText("Comment saved.").waitFor();
    await page.waitForTimeout(500);
    const { history } = await json(`alarms/${alarm}`);
    assert.equal(history.filter(({ action }) => action === "comment").length, 1);
    await close(opened, name);
    await removeAsset(id);
  },

  "an answer for another alarm, or an error that passes, leaves the comment": async (name) => {
    const { settings } = RULE;
    const id = await createAsset("alarmed", {
      alarms: [RULE, { quantity: { indicator: "kurtosis" }, warning_below: 100, settings }],
    });
    for (const [minute, amplitude] of [1, 20].entries()) await sendNoise(id, minute, amplitude);
    const { page, faults } = await open(`#/alarms?asset=${id}&show=all`);
    const detail = page.getByRole("region", { name: "Selected alarm" });
    const comment = detail.getByLabel("Comment", { exact: true });
    await row(page, id).getByRole("link", { name: "RMS" }).click();
    await detail.getByRole("heading", { name: "RMS" }).waitFor();
    await detail.getByLabel("Your name").fill("Ada");
    let release;
    const held = new Promise((resolve) => (release = resolve));
    await page.route("**/acknowledge", async (route) => {
      await held;
      await route.continue();
    });
    await detail.getByRole("button", { name: "Acknowledge" }).click();
    await row(page, id).getByRole("link", { name: "Kurtosis" }).click();
    await detail.getByRole("heading", { name: "Kurtosis" }).waitFor();
    await detail
      .getByText("Rule: warning below 100; raised by the first reading below, cleared by the first above.")
      .waitFor();
    await comment.fill("to be asked");
    release();
    await row(page, id).filter({ hasText: "RMS" }).getByText("Acknowledged").waitFor();
    await detail.getByRole("heading", { name: "Kurtosis" }).waitFor();
    assert.equal(await comment.inputValue(), "to be asked");

    const again = () => page.evaluate(() => document.dispatchEvent(new CustomEvent("recordschange")));
    const asked = new URL(`${page.url().split("#")[0]}v1/alarms/${parameters(page).get("alarm")}`).href;
    await page.route(asked, (route) => route.fulfill({ status: 429, json: { detail: "too many requests" } }));
    await again();
    await detail.getByText("too many requests").waitFor();
    await page.unroute(asked);
    await again();
    await detail.getByRole("heading", { name: "Kurtosis" }).waitFor();
    assert.equal(await comment.inputValue(), "to be asked");
    await shoot(page, name);
    assert.ok(
      faults.every((fault) => fault.includes("429")),
      `${faults}`,
    );
    await page.context().close();
    await removeAsset(id);
  },

  "an asset's page marks its alarms, and leads to them": async (name) => {
    const id = await alarmed([1, 20, 20, 1]);
    const opened = await open(`#/assets/${id}?trend=rms`);
    const { page } = opened;
    await drawn(page, "trends");
    for (const words of ["warning alarm raised", "alarm cleared"])
      await page.locator('[data-plot="trends"] .legend', { hasText: words }).waitFor();
    assert.equal(
      await page.locator('[data-plot="trends"] .shapelayer path').count(),
      5,
      "two marks, the selected record, and the levels of warning and danger",
    );
    await page
      .getByRole("region", { name: "Alarms and maintenance" })
      .getByRole("link", { name: "RMS" })
      .click();
    await page.getByRole("region", { name: "Selected alarm" }).getByText("back to normal").waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "maintenance is added and deleted": async (name) => {
    const id = await createAsset("maintained", {});
    for (let minute = 0; minute < 4; minute++) await sendNoise(id, minute, 1);
    const opened = await open(`#/assets/${id}?trend=rms`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.getByRole("button", { name: "Add maintenance" }).click();
    const time = page.getByLabel("Time, UTC");
    const proposed = async () => Date.parse(`${await time.inputValue()}Z`);
    assert.ok(Math.abs((await proposed()) - Date.now()) < 600_000, "old records stay before a replacement");
    await page.getByLabel("Wear measured").check();
    assert.match(await time.inputValue(), /^2026-03-01T08:03/, "measured at the displayed record");
    await page.getByLabel("Sensor replaced").check();
    assert.ok(Math.abs((await proposed()) - Date.now()) < 600_000);
    await time.fill("2026-03-01T08:02:00");
    await time.blur();
    await page.getByText("Affects 2 records at or after that time.").waitFor();
    await page.getByLabel("Your name").fill("Grace");
    await page.locator("#maintenance-comment").fill("100 mV/g");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    const events = page.getByRole("region", { name: "Alarms and maintenance" });
    await events.getByText("2026-03-01 08:02:00 UTC, entered by Grace, “100 mV/g”").waitFor();
    await page.locator('[data-plot="trends"] .annotation-text', { hasText: "Sensor replaced" }).waitFor();
    const { items } = await json(`assets/${id}/maintenance`);
    assert.deepEqual([items[0].kind, items[0].by], ["sensor_replaced", "Grace"]);
    // no record follows this entry, so the asset stays the same
    await page.getByRole("button", { name: "Add maintenance" }).click();
    await page.getByLabel("Operation changed").check();
    await page.getByLabel("Time, UTC").fill("2026-03-01T09:00:00");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await events.getByText("2026-03-01 09:00:00 UTC, entered by Grace").waitFor();
    page.on("dialog", (dialog) => dialog.accept());
    await events.getByRole("button", { name: "Delete entry: Operation changed" }).click();
    await events.getByText("2026-03-01 09:00:00 UTC").waitFor({ state: "detached" });
    await events.getByRole("button", { name: "Delete entry: Sensor replaced" }).click();
    await events.getByText("no maintenance entries").waitFor();
    assert.equal((await json(`assets/${id}/maintenance`)).items.length, 0);
    await close(opened, name);
    await removeAsset(id);
  },

  "an inspection is added, listed, and drawn on the wear plot": async (name) => {
    const { items: records } = await json(`assets/${asset}/segments?limit=100`);
    const time = records.map(({ start_time: start }) => start).sort()[40]; // with an error that leaves the estimates of other checks alone
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await drawn(page, "wear");
    await page.getByRole("button", { name: "Add maintenance" }).click();
    const depth = page.getByLabel("Measured depth (µm)");
    assert.ok(!(await depth.isVisible()), "asked for only where something was measured");
    await page.getByLabel("Wear measured").check();
    await page.getByLabel("Time, UTC").fill(time.slice(0, 19));
    await page.getByLabel("Your name").fill("Grace");
    const save = page.getByRole("button", { name: "Save", exact: true });
    await save.click();
    await page.getByText("Enter a depth from 0 to 100000 µm.").waitFor();
    assert.equal(await depth.getAttribute("aria-invalid"), "true");
    assert.ok(
      await depth.evaluate((input) => input === document.activeElement),
      "the field to mend has the focus",
    );
    await depth.fill("30");
    await page.getByText("Enter a depth").waitFor({ state: "detached" });
    assert.equal(await page.getByLabel("Standard error (µm)").inputValue(), "5");
    await page.getByLabel("Standard error (µm)").fill("0");
    await save.click();
    await page.getByText("Enter a number above 0 and up to 10000 µm.").waitFor();
    await page.getByLabel("Standard error (µm)").fill("40");
    await page.getByLabel("Measured gear").selectOption("Driven gear");
    await page.getByLabel("Place on the flank").selectOption("At the root");
    assert.equal((await json(`assets/${asset}/maintenance`)).items.length, 0, "nothing wrong was sent");
    await save.click();
    const events = page.getByRole("region", { name: "Alarms and maintenance" });
    await events
      .getByText(`30 ± 40 µm, driven gear, at the root, ${shownTime(time)}, entered by Grace`)
      .waitFor();
    await page.locator('[data-plot="wear"] .legend', { hasText: "± standard error" }).waitFor();
    await counted(page.locator('[data-plot="wear"] .errorbar'), 1);
    await page.locator('[data-plot="wear"] .annotation-text', { hasText: "30 ± 40 µm" }).waitFor();
    await page.locator('[data-plot="trends"] .annotation-text', { hasText: "Wear measured" }).waitFor();
    // an opaque label would look like a gap in the line below it
    const grounds = await page.evaluate(() =>
      ["wear", "trends"].flatMap((kind) =>
        document
          .querySelector(`[data-plot="${kind}"] .plot`)
          ._fullLayout.annotations.filter(({ text }) => /Wear measured|±/.test(text))
          .map(({ bgcolor }) => bgcolor),
      ),
    );
    assert.deepEqual(grounds, ["rgba(0,0,0,0)", "rgba(0,0,0,0)"]);
    const { items } = await json(`assets/${asset}/maintenance`);
    assert.deepEqual(
      [items[0].kind, items[0].inspection],
      ["inspected", { depth_um: 30, error_um: 40, gear: 2, place: "root" }],
    );
    await shoot(page, `${name} shown`);
    page.on("dialog", (dialog) => dialog.accept());
    await events.getByRole("button", { name: "Delete entry: Wear measured" }).click();
    await page.locator('[data-plot="wear"] .errorbar').waitFor({ state: "detached" });
    await close(opened, name);
  },

  "alarms on a phone": async (name) => {
    const id = await alarmed([1, 20]);
    const { id: alarm } = await alarmOf(id);
    const opened = await open(`#/alarms?alarm=${alarm}`, PHONE);
    await opened.page
      .getByRole("region", { name: "Selected alarm" })
      .getByText("warning raised at")
      .waitFor();
    await row(opened.page, id).waitFor();
    await noSidewaysScrolling(opened.page);
    // a chosen alarm is brought into view, above the list
    await opened.page.goto(opened.page.url().replace(/[?&]alarm=.*/, ""));
    await row(opened.page, id).getByRole("link", { name: "RMS" }).click();
    await opened.page.waitForFunction(() => document.activeElement?.ariaLabel === "Selected alarm");
    const detail = opened.page.getByRole("region", { name: "Selected alarm" });
    await detail.getByText("warning raised at").waitFor();
    const { y } = await detail.boundingBox();
    assert.ok(y >= 0 && y < 422, `in the upper half of the screen: ${y}`);
    await close(opened, name);
    await removeAsset(id);
  },
};
