// Waterfall, match and settings: clicks and inputs.

import assert from "node:assert/strict";
import {
  asset,
  base,
  close,
  counted,
  createAsset,
  drawn,
  json,
  open,
  parameters,
  recordShown,
  removeAsset,
  shoot,
} from "./page.mjs";

export const CHECKS = {
  "a click on a row of the waterfall opens its record": async (name) => {
    const opened = await open(`#/assets/${asset}/waterfall?axis=orders&max=60`);
    const { page } = opened;
    await drawn(page, "waterfall");
    const title = await page.locator('[data-plot="waterfall"] .infolayer').first().textContent();
    assert.ok(title.includes("Order of the driving shaft"), title);
    const box = await page.locator('[data-plot="waterfall"] .nsewdrag').first().boundingBox();
    const [x, y] = [box.x + 0.5 * box.width, box.y + 0.5 * box.height];
    await page.mouse.move(x, y);
    const label = page.locator('[data-plot="waterfall"] .cell-label');
    await label.waitFor();
    assert.match(await label.textContent(), /UTC, [\d.]+ order: −?-?[\d.]+ dB$/);
    await page.mouse.click(x, y);
    await page.waitForURL(
      (url) => url.hash.startsWith(`#/assets/${asset}?`) && url.hash.includes("segment="),
    );
    await recordShown(page);
    await close(opened, name);
  },

  "a cursor over the waterfall reads the latest record": async (name) => {
    const opened = await open(`#/assets/${asset}/waterfall?axis=orders&max=60`);
    const { page } = opened;
    await drawn(page, "waterfall");
    await page.locator("#waterfall-cursor").selectOption("h");
    const readout = page.locator(".cursor-readout");
    await readout.getByText("Harmonics: spacing order 24").waitFor();
    const at = Number(new URLSearchParams(page.url().split("?")[1]).get("cursor").split("~")[1]);
    const { items, position } = await json(
      `assets/${asset}/waterfall?axis=orders&max=60&max_records=600&cells=500`,
    );
    const levels = items.findLast(({ level_db: levels }) => levels).level_db;
    const cell = (x) => Math.round((x - position[0]) / (position[1] - position[0]));
    const strongest = Math.max(...[1, 2].map((n) => 10 ** (levels[cell(n * at)] / 20)));
    assert.ok(
      (await readout.textContent()).includes(`${Number(strongest.toPrecision(3))}`),
      await readout.textContent(),
    );
    await counted(page.locator('[data-plot="waterfall"] .cursor-line'), 2);
    await page.locator("#waterfall-cursor").selectOption("s");
    await readout.getByText("Sidebands: centre order 24").waitFor();
    await close(opened, name);
    assert.deepEqual(opened.faults, []);
  },

  "a long pause between records is marked in the waterfall": async () => {
    const { page } = await open(`#/assets/${asset}/waterfall`, {}, (page) =>
      page.route(/\/v1\/.*\/waterfall/, async (route) => {
        const answer = await route.fetch();
        const json = await answer.json();
        json.items.splice(20, 60);
        await route.fulfill({ response: answer, json });
      }),
    );
    await drawn(page, "waterfall");
    const pauses = page.locator('[data-plot="waterfall"] .annotation', { hasText: "min without records" });
    assert.equal(await pauses.count(), 1);
    await page.getByText("long pauses are marked").waitFor();
    await page.context().close();
  },

  "a bearing is chosen for the cursor over the waterfall": async (name) => {
    const opened = await open(`#/assets/${asset}/waterfall?axis=orders&max=20`);
    const { page } = opened;
    await drawn(page, "waterfall");
    const bearing = page.getByRole("combobox", { name: "Bearing", exact: true });
    assert.ok(await bearing.isHidden(), "no choice without its cursor");
    await page.locator("#waterfall-cursor").selectOption("b");
    await bearing.selectOption("ZA2115");
    // 16 rollers of 8.407 mm on 71.501 mm at 15.17°
    const readout = page.locator(".cursor-readout");
    await readout.getByText("ZA-2115").waitFor();
    await page.locator(".bench-bearing", { hasText: "BPFO 7.092" }).waitFor();
    assert.ok(await page.getByLabel("Shaft speed, Hz").isHidden(), "orders need no speed");
    await bearing.selectOption("g");
    await page.getByLabel("Rolling elements").fill("9");
    await page.getByLabel("Rolling element diameter, mm").fill("7.94");
    await page.getByLabel("Pitch diameter, mm").fill("39.04");
    await page.getByLabel("Pitch diameter, mm").press("Enter");
    await page.locator(".bench-bearing", { hasText: "BPFO 3.5848" }).waitFor();
    assert.equal(parameters(page).get("ecursor"), null);
    await close(opened, name);
  },

  "the match shows features, flank and the mesh of the best state": async (name) => {
    const opened = await open(`#/assets/${asset}/match`);
    const { page } = opened;
    for (const kind of ["features", "posterior", "stiffness", "transmission"]) await drawn(page, kind);
    const { segment_id: id } = await json(`assets/${asset}/wear`);
    const match = await json(`segments/${id}/match`);
    await page.locator(".match-words", { hasText: `Best library state: ${match.state_index}` }).waitFor();
    assert.equal(await page.locator(".tooth svg").count(), 2);
    const labels = await page.locator('[data-plot="features"] .ytick').allTextContents();
    assert.equal(labels.length, match.features.length, `${labels}`);
    await close(opened, name);
  },

  "the trend of novelty shows the level of its alarm": async (name) => {
    const opened = await open(`#/assets/${asset}?trend=novelty`);
    const { page } = opened;
    await drawn(page, "trends");
    const words = page.locator('[data-plot="trends"] .annotation', { hasText: "warning above 4" });
    await words.first().waitFor();
    const answer = await json(`assets/${asset}/indicators?names=novelty`);
    assert.ok(
      answer.items.some(({ novelty }) => novelty >= 0),
      "records after the baseline have a novelty",
    );
    await close(opened, name);
  },

  "the report lists alarms": async (name) => {
    const opened = await open(`v1/assets/${asset}/report`);
    const { page } = opened;
    await page.locator("h2", { hasText: "Alarms" }).waitFor();
    assert.match(await page.locator("h3", { hasText: "Wear depth" }).textContent(), /: (warning|danger), /);
    assert.ok((await page.locator("svg line.mark").count()) > 0, "alarms are marked on the wear");
    await close(opened, name);
  },

  "settings are changed, and an invalid one is rejected at its field": async (name) => {
    const id = `settings-${Date.now()}`;
    const spec = {
      id,
      name: "Before",
      gear: { teeth: [31, 62], shaft_speed_hz: 10 },
      limits: { warning_um: 50, danger_um: 90 },
    };
    const made = await fetch(`${base}/v1/assets`, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(spec),
    });
    assert.equal(made.status, 201);
    const { page, faults } = await open(`#/assets/${id}/settings`);
    await page.getByLabel("Name", { exact: true }).fill("After");
    await page.getByLabel("Danger (µm)").fill("120");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.getByText("Saved.").waitFor();
    const saved = await json(`assets/${id}`);
    assert.deepEqual([saved.name, saved.limits.danger_um], ["After", 120]);
    assert.deepEqual(faults, []);
    await page.getByLabel("Teeth, driving").fill("-3");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    const driving = page.locator(".setup-field", { has: page.getByLabel("Teeth, driving") }).first();
    await driving.getByText("Teeth, driving: expected two tooth counts from 4 to 1000").waitFor();
    assert.equal(await page.getByLabel("Teeth, driving").first().getAttribute("aria-invalid"), "true");
    await page.getByText("Not saved. Check the highlighted field.").waitFor();
    assert.equal((await json(`assets/${id}`)).gear.teeth[0], 31);
    // a malformed number is not an empty field
    const question = page.waitForEvent("dialog");
    const left = page.getByRole("link", { name: "Records", exact: true }).click();
    await (await question).dismiss();
    await left;
    assert.match(page.url(), /\/settings/, "the edits stay");
    assert.equal(await page.getByLabel("Teeth, driving").first().inputValue(), "-3");
    await page.getByRole("button", { name: "Undo changes" }).click();
    const danger = page.getByLabel("Danger (µm)");
    await danger.fill("");
    await danger.pressSequentially("1e");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.getByText("Danger: expected a number").waitFor();
    await page.getByText("Not saved. Check the highlighted field.").waitFor();
    assert.equal((await json(`assets/${id}`)).limits.danger_um, 120);
    await page.context().close();
    await fetch(`${base}/v1/assets/${id}`, { method: "DELETE" });
  },

  "a description that has changed since the page was opened is not overwritten": async (name) => {
    const id = await createAsset("shared", {});
    for (const [path, button] of [
      [`#/assets/${id}/settings`, "Save"],
      [`#/new?edit=${id}`, "Save asset"],
    ]) {
      const { page, faults } = await open(path);
      const field = page.getByLabel("Name", { exact: true });
      await page.waitForFunction(() => document.querySelector("#setting-baseline-records, #setup-id")?.value);
      const changed = { ...(await json(`assets/${id}`)), name: `Of another window, ${button}` };
      await fetch(`${base}/v1/assets/${id}`, {
        method: "PUT",
        headers: { "content-type": "application/json" },
        body: JSON.stringify(changed),
      });
      await field.fill("Of this window");
      await page.getByRole("button", { name: button, exact: true }).click();
      await page.getByText("Saving failed: the asset has been changed since this page was opened").waitFor();
      assert.equal((await json(`assets/${id}`)).name, changed.name);
      await page.reload();
      await page.waitForFunction(
        (was) => document.querySelector("#setting-name, #setup-name")?.value === was,
        changed.name,
      );
      await field.fill("Of this window");
      await page.getByRole("button", { name: button, exact: true }).click();
      for (const until = Date.now() + 20_000; Date.now() < until; await page.waitForTimeout(50))
        if ((await json(`assets/${id}`)).name === "Of this window") break;
      assert.equal((await json(`assets/${id}`)).name, "Of this window");
      assert.ok(
        faults.every((fault) => fault.includes("412")),
        `${faults}`,
      );
      await shoot(page, `${name} ${button}`);
      await page.context().close();
    }
    await removeAsset(id);
  },

  "alarm rules and operating bins are set, and an invalid level is rejected": async (name) => {
    const id = await createAsset("ruled", { limits: { warning_um: 50, danger_um: 90 } });
    const opened = await open(`#/assets/${id}/settings`);
    const { page } = opened;
    await page.getByText("Wear depth: warning above 50 µm, danger above 90 µm").waitFor();
    await page.getByLabel("Custom rules").check();
    await page.getByRole("button", { name: "Add rule" }).click();
    const rule = page
      .locator(".setting-row")
      .filter({ has: page.getByLabel("Quantity") })
      .last();
    await rule.getByLabel("Indicator", { exact: true }).fill("kurtosis");
    await rule.getByLabel("Warning above").fill("4");
    await page.getByRole("button", { name: "Add operating bin" }).click();
    await page.getByLabel("Name", { exact: true }).last().fill("full load");
    await page.getByLabel("Torque from (N·m)").fill("80");
    await page.locator(".setting-row").last().getByLabel("up to").last().fill("120");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.getByText("Saved.").waitFor();
    const { alarms, operating_bins: bins } = await json(`assets/${id}`);
    assert.deepEqual(
      alarms.map(({ quantity }) => quantity),
      ["wear_um", "novelty", "joint_novelty", { indicator: "kurtosis" }],
    );
    assert.deepEqual(bins, [{ name: "full load", torque_nm: [80, 120] }]);
    assert.deepEqual(opened.faults, []);
    await rule.getByLabel("Danger above").fill("2");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await rule.getByText("Danger above: expected a level above warning").waitFor();
    assert.equal(await rule.getByLabel("Danger above").getAttribute("aria-invalid"), "true");
    assert.equal(await page.locator('.setting-row [aria-invalid="true"]').count(), 1, "only in its row");
    await page.locator(".setting-row").last().getByLabel("up to").last().fill("12");
    await rule.getByLabel("Danger above").fill("9");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page
      .locator(".setting-row")
      .last()
      .getByText(/^Torque from \(N·m\): expected two numbers .* the lower one first$/)
      .waitFor();
    assert.ok(await rule.getByText("Danger above: expected").isHidden(), "the mended error is gone");
    await page.locator(".setting-row").last().getByLabel("up to").last().fill("120");
    await rule.getByLabel("Danger above").fill("");
    await rule.getByLabel("Danger above").pressSequentially("-");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await rule.getByText("Danger above: expected a number").waitFor();
    await shoot(page, name);
    await page.context().close();
    await removeAsset(id);
  },

  "the gear pair is drawn to scale as it is typed": async (name) => {
    const opened = await open(`#/assets/${asset}/settings`);
    const { page } = opened;
    const drawing = page.locator(".gear-drawing svg");
    await drawing.waitFor();
    const before = await drawing.getAttribute("aria-label");
    assert.ok(before.includes("24 teeth"), before);
    await page.getByLabel("Teeth, driving").fill("40");
    await page.locator('.gear-drawing svg[aria-label*="40 teeth"]').waitFor();
    await close(opened, name);
  },

  "trends are selected, on a logarithmic scale, by operating point": async (name) => {
    const opened = await open(`#/assets/${asset}?trend=kurtosis,peak&bins=speed`);
    const { page } = opened;
    await drawn(page, "trends");
    await page.locator('[data-plot="trends"] .legend li').first().waitFor();
    await page.getByLabel("Log", { exact: true }).first().check();
    await page.waitForFunction(
      () => document.querySelector('[data-plot="trends"] .plot').layout.yaxis.type === "log",
    );
    assert.equal(parameters(page).get("log"), "1");
    const titles = await page.locator('[data-plot="trends"] .infolayer').first().textContent();
    assert.ok(titles.includes("Kurtosis") && titles.includes("Peak"), titles);
    await close(opened, name);
  },
};
