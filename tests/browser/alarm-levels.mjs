// Alarm rules edited on the trend and wear plots, and several alarms acknowledged at once.

import assert from "node:assert/strict";
import { asset, close, createAsset, drawn, json, open, removeAsset, sendNoise, shoot } from "./page.mjs";

const RULE = {
  quantity: { indicator: "rms" },
  warning: 5,
  settings: { raise: 1, raise_of: 1, clear: 1, clear_of: 1 },
};
const LOUDNESS = [1, 1.1, 1, 1.1, 1, 1.1, 1, 1.1, 1, 3, 1, 3];

async function heard(more) {
  const id = await createAsset("levels", { baseline: { records: 8 }, ...more });
  for (const [minute, amplitude] of LOUDNESS.entries()) await sendNoise(id, minute, amplitude);
  return id;
}

const trial = (page, words) => page.locator(".rule-trial", { hasText: words }).waitFor();

export const CHECKS = {
  "a level is dragged on the trend, tried on the history, suggested from the baseline, and saved": async (
    name,
  ) => {
    const id = await heard({ alarms: [RULE, { quantity: "novelty", warning: 1000 }] });
    const opened = await open(`#/assets/${id}?trend=rms,kurtosis`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.getByRole("button", { name: "Alarm levels…" }).click();
    await trial(page, "On the 12 records of channel a1, this rule would have raised no alarm.");
    const level = page.getByRole("slider", { name: "Warning above, RMS" });
    await level.waitFor();
    await level.scrollIntoViewIfNeeded();
    const box = await level.locator("span").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x, y + 60, { steps: 4 });
    await page.mouse.move(x, y + 100, { steps: 4 });
    await page.mouse.up();
    const field = page.locator(".plot-trends").getByLabel("Warning above", { exact: true });
    const dragged = Number(await field.inputValue());
    assert.ok(dragged > 0 && dragged < 5, `${dragged}`);
    assert.equal((await json(`assets/${id}`)).alarms[0].warning, 5, "nothing is saved by dragging");
    await level.focus();
    await page.keyboard.press("ArrowUp");
    await page.waitForFunction(
      (before) => Number(document.getElementById("rule-warning").value) > before,
      dragged,
    );
    assert.ok(
      await level.evaluate((handle) => handle === document.activeElement),
      "the focus stays on the level",
    );

    await page.locator("#rule-k").fill("4.2");
    await page.getByRole("button", { name: "Suggest from baseline" }).click();
    await page.getByText("Baseline of 8 records: mean").waitFor();
    await trial(page, "this rule would have raised 2 alarms (2 dangers)");
    await shoot(page, `${name} tried`);
    const suggested = Number(await field.inputValue());
    const known = (await json(`assets/${id}/indicators/baseline?names=rms`)).items[0];
    assert.ok(Math.abs(suggested / (known.mean + 4.2 * known.standard_deviation) - 1) < 0.01, `${suggested}`);
    await page.getByRole("button", { name: "Save rule" }).click();
    await page.locator(".rule-panel .result", { hasText: "Saved." }).waitFor();
    const { alarms } = await json(`assets/${id}`);
    assert.equal(alarms.length, 2, "the other rule stays");
    assert.deepEqual([alarms[0].warning, alarms[0].settings], [suggested, RULE.settings]);
    await page.getByRole("button", { name: "Alarm levels…" }).click();
    await level.waitFor({ state: "detached" });
    await close(opened, name);
    await removeAsset(id);
  },

  "default rules that become custom are announced, and follow changed limits on request": async (name) => {
    const id = await heard({ limits: { warning_um: 100, danger_um: 200 } });
    const opened = await open(`#/assets/${id}?trend=rms`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.getByRole("button", { name: "Alarm levels…" }).click();
    const note = page.locator(".plot-trends").getByText("Saving turns the default rules of this asset into");
    await note.waitFor();
    await page.locator("#rule-danger").fill("30");
    await page.getByRole("button", { name: "Save rule" }).click();
    await page.locator(".rule-panel .result", { hasText: "are now custom rules" }).waitFor();
    const questions = [];
    page.on("dialog", (dialog) => {
      questions.push(dialog.message());
      dialog.accept();
    });
    const wearRule = async () =>
      (await json(`assets/${id}`)).alarms.find(({ quantity }) => quantity === "wear_um");
    await page.goto(page.url().replace(/#.*/, `#/assets/${id}/settings`));
    await page.locator("#setting-limits-warning_um").fill("80");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.locator(".settings .result", { hasText: "Saved." }).waitFor();
    assert.deepEqual(questions, [
      "The custom alarm rule on wear depth has warning above 100 µm, danger above 200 µm. " +
        "Change it to warning above 80 µm, danger above 200 µm?",
    ]);
    const { warning, danger, hysteresis } = await wearRule();
    assert.deepEqual([warning, danger, hysteresis], [80, 200, 4]);
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.locator(".settings .result", { hasText: "Saved." }).waitFor();
    assert.equal(questions.length, 1, "limits that stay as they are raise no question");
    await close(opened, name);
    await removeAsset(id);
  },

  "a suggestion that arrives late does not change another rule": async (name) => {
    const id = await heard({ alarms: [RULE] });
    const opened = await open(`#/assets/${id}?trend=rms,kurtosis`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.getByRole("button", { name: "Alarm levels…" }).click();
    let release;
    const held = new Promise((resolve) => (release = resolve));
    await page.route(/indicators\/baseline\?.*names=rms/, async (route) => {
      await held;
      await route.continue();
    });
    const asked = page.waitForRequest(/indicators\/baseline\?.*names=rms/);
    await page.getByRole("button", { name: "Suggest from baseline" }).click();
    await asked;
    await page.locator(".plot-trends").getByLabel("Alarm on").selectOption("kurtosis");
    await trial(page, "No level is set");
    const answered = page.waitForResponse(/indicators\/baseline\?.*names=rms/);
    release();
    await (await answered).finished();
    await page.waitForTimeout(300);
    for (const level of ["Warning above", "Danger above"])
      assert.equal(await page.locator(".plot-trends").getByLabel(level, { exact: true }).inputValue(), "");
    await trial(page, "No level is set");
    await close(opened, name);
    await removeAsset(id);
  },

  "a level of the wear depth is dragged on its plot and tried": async (name) => {
    const before = (await json(`assets/${asset}`)).summary.alarm_rules;
    const { warning } = before.find(({ quantity }) => quantity === "wear_um");
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await drawn(page, "wear");
    const card = page.locator(".plot-wear");
    await card.getByRole("button", { name: "Alarm levels…" }).click();
    await card.locator(".rule-trial", { hasText: "this rule would have raised" }).waitFor();
    const level = card.getByRole("slider", { name: "Warning above, Wear depth" });
    await level.waitFor();
    await level.scrollIntoViewIfNeeded();
    const box = await level.locator("span").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x, y + 20, { steps: 4 });
    await page.mouse.up();
    const field = card.getByLabel("Warning above", { exact: true });
    const dragged = Number(await field.inputValue());
    assert.ok(dragged > 0 && dragged < warning, `${dragged}`);
    await card.getByText(`warning alarm above ${Math.round(dragged)} µm`).waitFor();
    assert.equal(
      await card.getByRole("button", { name: "Suggest from baseline" }).isVisible(),
      false,
      "a depth has no baseline of its own",
    );
    await shoot(page, `${name} dragged`);
    assert.deepEqual(
      (await json(`assets/${asset}`)).summary.alarm_rules,
      before,
      "nothing is saved by dragging",
    );
    await card.getByRole("button", { name: "Alarm levels…" }).click();
    await level.waitFor({ state: "detached" });
    await close(opened, name);
  },

  "several alarms are acknowledged with one name": async (name) => {
    const ids = [
      await heard({ alarms: [{ ...RULE, warning: 2 }] }),
      await heard({ alarms: [{ ...RULE, warning: 2 }] }),
    ];
    const opened = await open("#/alarms");
    const { page } = opened;
    const pick = (id) => page.getByLabel(`Select the alarm RMS of ${id}, channel a1`);
    for (const id of ids) await pick(id).check();
    assert.equal(new URL(page.url()).hash, "#/alarms", "choosing opens nothing");
    await page.getByText("2 alarms selected").waitFor();
    await page.locator("#alarms-by").fill("Ada");
    await page.locator("#alarms-comment").fill("looked at both");
    await shoot(page, `${name} chosen`);
    await page.getByRole("button", { name: "Acknowledge 2 alarms" }).click();
    await page.getByText("2 alarms acknowledged.").waitFor();
    for (const id of ids) {
      await pick(id).waitFor({ state: "detached" });
      const { items } = await json(`alarms?asset=${id}`);
      assert.equal(items[0].state, "acknowledged");
      const { history } = await json(`alarms/${items[0].id}`);
      assert.deepEqual([history.at(-1).by, history.at(-1).comment], ["Ada", "looked at both"]);
      await removeAsset(id);
    }
    await close(opened, name);
  },
};
