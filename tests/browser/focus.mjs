// The focus and what is half typed stay while updates arrive.

import assert from "node:assert/strict";
import { asset, base, close, createAsset, drawn, json, open, removeAsset, sendNoise } from "./page.mjs";

const RULE = {
  quantity: { indicator: "rms" },
  warning: 100,
  settings: { raise: 1, raise_of: 1, clear: 1, clear_of: 1 },
};

const post = async (path, body) => {
  const answer = await fetch(`${base}/v1/${path}`, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify(body),
  });
  assert.ok(answer.ok, await answer.clone().text());
  return answer.json();
};

const hasFocus = async (locator, words) =>
  assert.ok(await locator.evaluate((element) => element === document.activeElement), words);

/** An asset with two records. */
async function begun(more = {}) {
  const id = await createAsset("focus", more);
  for (const minute of [0, 1]) await sendNoise(id, minute);
  return id;
}

export const CHECKS = {
  "the links between an asset's pages keep the focus": async (name) => {
    const id = await begun();
    const opened = await open(`#/assets/${id}`);
    const { page } = opened;
    await page.getByText("2 records").waitFor();
    const link = page.getByRole("link", { name: "Match", exact: true });
    await link.focus();
    await sendNoise(id, 2);
    await page.getByText("3 records").waitFor();
    await hasFocus(link, "on the overview");
    await page.goto(`${base}/#/assets/${id}/records`);
    await page.locator(".record-table tbody tr").first().waitFor();
    await link.focus();
    await sendNoise(id, 3);
    await page.locator(".record-table tbody tr").nth(3).waitFor();
    await hasFocus(link, "on another page");
    await close(opened, name);
    await removeAsset(id);
  },

  "an alarm level that is half typed stays": async (name) => {
    const id = await begun({ alarms: [RULE] });
    const opened = await open(`#/assets/${id}?trend=rms`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.locator(".plot-trends").getByRole("button", { name: "Alarm levels…" }).click();
    const field = page.locator("#rule-warning");
    await field.fill("");
    await field.pressSequentially("12");
    await sendNoise(id, 2);
    await page.getByText("3 records").waitFor();
    await page.waitForFunction(
      () => document.querySelector('[data-plot="trends"] .plot').data[0].x.length === 3,
    );
    await hasFocus(field, "the field has the focus");
    await field.pressSequentially("5");
    assert.equal(await field.inputValue(), "125");
    await close(opened, name);
    await removeAsset(id);
  },

  "a time of the records' filter that is half typed stays, and so does the focus on a link": async (name) => {
    const id = await begun();
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    const rows = page.locator(".record-table tbody tr");
    await rows.nth(1).waitFor();
    const from = page.locator("#records-from");
    await from.focus();
    await page.keyboard.type("0301");
    await sendNoise(id, 2);
    await rows.nth(2).waitFor();
    await hasFocus(from, "the field has the focus");
    await page.keyboard.type("2026");
    await page.keyboard.press("Tab"); // from the year, which may have more digits
    await page.keyboard.type("080100AM");
    assert.match(await from.inputValue(), /^2026-03-01T08:01/);
    await from.blur();
    await rows.nth(2).waitFor({ state: "detached" });
    const link = rows.last().getByRole("link", { name: "Download the raw recording of 2026-03-01 08:01:00" });
    await link.focus();
    await sendNoise(id, 3);
    await rows.nth(2).waitFor();
    await hasFocus(link, "the link has the focus");
    await close(opened, name);
    await removeAsset(id);
  },

  "a selection with Shift holds while records arrive": async (name) => {
    const id = await begun();
    const opened = await open(`#/assets/${id}/records`);
    const { page } = opened;
    const boxes = page.locator(".record-table tbody input");
    await boxes.nth(1).waitFor();
    await boxes.nth(0).click();
    await sendNoise(id, 2);
    await boxes.nth(2).waitFor();
    await boxes.nth(2).click({ modifiers: ["Shift"] });
    assert.deepEqual(
      await boxes.evaluateAll((all) => all.map((each) => /** @type {HTMLInputElement} */ (each).checked)),
      [false, true, true],
      "from the record clicked first, wherever its row is",
    );
    await close(opened, name);
    await removeAsset(id);
  },

  "buttons of alarms, maintenance and replays keep the focus": async (name) => {
    const id = await begun({ alarms: [{ ...RULE, warning: 0.1 }] });
    const report = (time) =>
      post(`assets/${id}/maintenance`, {
        time: `2026-03-01T${time}:00Z`,
        kind: "sensor_replaced",
        by: "Ada",
      });
    await report("06:00");
    const opened = await open(`#/assets/${id}`);
    const { page } = opened;
    const remove = page.getByRole("button", { name: "Delete entry: Sensor replaced, 2026-03-01 06:00:00" });
    await remove.focus();
    await report("08:01");
    await page.getByRole("button", { name: "Delete entry: Sensor replaced, 2026-03-01 08:01:00" }).waitFor();
    await hasFocus(remove, "the button of an entry");

    const [{ id: alarm }] = (await json(`alarms?asset=${id}`)).items;
    await page.goto(`${base}/#/alarms?show=all&asset=${id}`);
    const link = page.locator(`[data-alarm="${alarm}"]`).getByRole("link", { name: id });
    await link.focus();
    await post(`alarms/${alarm}/acknowledge`, { by: "Ada" });
    await page.locator(`[data-alarm="${alarm}"]`).getByText("Acknowledged").waitFor();
    await hasFocus(link, "the link to the alarm's asset, in a row that has changed");
    await close(opened, name);
    await removeAsset(id);
  },

  "the bench's buttons keep the focus when their records move": async (name) => {
    const { items } = await json(`assets/${asset}/segments?limit=3`);
    const opened = await open(`#/bench?records=${items.map(({ id }) => id).join(",")}&show=none`);
    const { page } = opened;
    const rowOf = ({ id }) => page.locator(`.bench-records [data-record="${id}"]`);
    await rowOf(items[2]).getByRole("link").waitFor();
    const inRow = async (item) =>
      assert.equal(
        await page.evaluate(
          () => /** @type {HTMLElement} */ (document.activeElement?.closest("[data-record]"))?.dataset.record,
        ),
        item.id,
      );
    await rowOf(items[1])
      .getByRole("button", { name: /^Make first/ })
      .focus();
    await page.keyboard.press("Enter");
    await rowOf(items[1]).getByText("Reference for the others").waitFor();
    await inRow(items[1]);
    await rowOf(items[1])
      .getByRole("button", { name: /^Remove/ })
      .focus();
    await page.keyboard.press("Enter");
    await rowOf(items[1]).waitFor({ state: "detached" });
    await inRow(items[0]);
    await close(opened, name);
  },
};
