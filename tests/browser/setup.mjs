// The asset form: errors at their fields, the wear preview, copying, and deleting.

import assert from "node:assert/strict";
import {
  asset,
  base,
  close,
  drawn,
  json,
  noSidewaysScrolling,
  open,
  PHONE,
  removeAsset,
  say,
  sendNoise,
  shoot,
  shots,
} from "./page.mjs";

const NUMBERS = {
  "Teeth, driving": "20",
  "Teeth, driven": "40",
  "Driving shaft speed (rpm)": "1500",
  "Torque on the driving gear (N·m)": "5",
  "Module (mm)": "1",
  "Face width (mm)": "8",
  "Bore radius, driving (mm)": "3",
  "Bore radius, driven (mm)": "5",
};

export async function fill(page, values) {
  for (const [label, value] of Object.entries(values))
    await page.getByLabel(label, { exact: true }).fill(value);
}

const field = (page, label) => page.locator(".setup-field", { has: page.getByLabel(label, { exact: true }) });
const worn = (page) => page.locator(".preview[data-wear]").waitFor();

/** Moves a slider to a fraction of its range, as a user does. */
const slide = (page, name, part) =>
  page.locator(`#preview-${name}`).evaluate((input, part) => {
    input.value = Number(input.min) + part * (Number(input.max) - Number(input.min));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, part);

export const CHECKS = {
  "unknown units and limits beyond the library are pointed out, in both forms": async () => {
    const { page } = await open("#/new");
    await page.locator("#setup-pair option", { hasText: "Shen" }).waitFor({ state: "attached" });
    await page.getByLabel("Gear pair, for wear in µm").selectOption("shen2022");
    await page.getByText("Wear can be estimated up to 245 µm for this pair.").waitFor();
    const danger = page.locator("#setup-limits-danger-um");
    await danger.fill("300");
    const beyond = page.getByText("No estimate reaches this limit: wear is estimated up to 245 µm.");
    await beyond.waitFor();
    assert.match(await danger.getAttribute("aria-describedby"), /setup-limits-danger-um-warning/);
    await danger.fill("200");
    await beyond.waitFor({ state: "hidden" });
    const unknown = page.getByText("“m/sec” is stored as it is, but not converted");
    await page.locator("#setup-sensor-unit").fill("m/sec");
    await unknown.waitFor();
    await page.goto(page.url().replace(/#.*/, `#/assets/${asset}/settings`));
    await page.locator("#setting-limits-danger_um").fill("300");
    await beyond.waitFor();
    await page.locator("#setting-sensor-unit").fill("m/sec");
    await unknown.waitFor();
    await page.getByText("Stored records keep their unit.").waitFor();
    await page.context().close();
  },

  "a machine without gears is created with its bearing": async (name) => {
    const id = `fan-${Date.now()}`;
    const opened = await open("");
    const { page } = opened;
    await page.getByRole("link", { name: "New asset" }).click();
    await page.getByText("Wear needs torque, module and face width. Without them, choose").waitFor();
    await page.getByLabel("Gear pair, for wear in µm").selectOption("no-gears");
    await page.getByLabel("Teeth, driving", { exact: true }).waitFor({ state: "hidden" });
    for (const words of ["Gear pair to scale", "Wear preview", "Limits on wear depth"])
      await page.getByText(words, { exact: true }).waitFor({ state: "hidden" });
    await fill(page, {
      Name: id,
      "Nominal shaft speed (rpm)": "1800",
      Bearing: "de",
      "Rolling elements": "9",
      "Rolling element diameter (mm)": "7.94",
      "Pitch diameter (mm)": "39.04",
    });
    await page.getByLabel("Velocity zones (ISO 20816)").selectOption("group_2_rigid");
    await page.getByRole("button", { name: "Create asset" }).click();
    await page.getByText("Waiting for the first record").waitFor();
    const made = await json(`assets/${id}`);
    assert.deepEqual(
      [made.gear, made.shaft.speed_hz, made.bearings[0].rolling_elements, made.velocity_zones.machine_class],
      [undefined, 30, 9, "group_2_rigid"],
    );
    await sendNoise(id, 1);
    await page.getByText("Velocity zones A to D").waitFor();
    await page.getByRole("link", { name: "Settings" }).click();
    // both forms have one unit for a speed
    const speed = page.getByLabel("Nominal shaft speed (rpm)", { exact: true });
    await speed.waitFor();
    assert.equal(await speed.inputValue(), "1800");
    await speed.fill("1500");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page.getByText("Saved.").waitFor();
    assert.equal((await json(`assets/${id}`)).shaft.speed_hz, 25);
    await removeAsset(id);
    await close(opened, name);
  },

  "an asset is created, copied, edited and deleted": async (name) => {
    const id = `form-${Date.now()}`;
    const opened = await open("");
    const { page } = opened;
    await page.getByRole("link", { name: "New asset" }).click();
    await page.getByText("Still required: “Teeth, driving”").waitFor();
    await fill(page, { Name: `Form ${id.slice(5)}`, ...NUMBERS });
    assert.equal(await page.getByLabel("Id", { exact: true }).inputValue(), id, "the id follows the name");
    await fill(page, { "Warning (µm)": "20", "Danger (µm)": "30" });
    await page.locator(".measures li", { hasText: "Contact ratio" }).waitFor();
    assert.equal(await page.locator('.measures [data-verdict="impossible"]').count(), 0);
    await page.getByText("All other fields as JSON").click();
    await page
      .locator("#setup-json")
      .fill(
        '{ "bands": [{ "name": "low", "band_hz": [10, 1000] }], "gear": { "pair": { "errors": { "seed": 7 } } } }',
      );
    await page.getByRole("button", { name: "Create asset" }).click();
    await page.getByText("Waiting for the first record").waitFor();
    const made = await json(`assets/${id}`);
    assert.deepEqual(
      [
        made.gear.teeth,
        made.gear.shaft_speed_hz,
        made.gear.pair.geometry.teeth,
        made.gear.pair.operation.shaft_speed_hz,
      ],
      [[20, 40], 25, [20, 40], 25],
    );
    assert.deepEqual(
      [made.limits, made.bands[0].name, made.gear.pair.errors.seed],
      [{ warning_um: 20, danger_um: 30 }, "low", 7],
    );

    await page.getByRole("link", { name: "Settings" }).click();
    await page.getByRole("link", { name: "Edit gears and all fields…" }).click();
    await page.getByRole("heading", { name: `Edit ${id}` }).waitFor();
    await field(page, "Module (mm)").waitFor();
    await page.waitForFunction(
      () => document.getElementById("setup-gear-pair-geometry-module-mm")?.value === "1",
    );
    await fill(page, { "Profile shift, driving (modules)": "0.2" });
    await page.getByRole("button", { name: "Save asset" }).click();
    await page.getByText("Waiting for the first record").waitFor();
    const edited = await json(`assets/${id}`);
    assert.deepEqual(
      [edited.gear.pair.geometry.profile_shift, edited.bands.length, edited.gear.pair.errors.seed],
      [[0.2, 0], 1, 7],
    );

    await page.goto(`${base}/#/new?copy=${id}`);
    await page.waitForFunction(() => document.getElementById("setup-id")?.value.endsWith("-copy"));
    await page.getByRole("button", { name: "Create asset" }).click();
    await page.getByText("Waiting for the first record").waitFor();
    assert.deepEqual((await json(`assets/${id}-copy`)).gear, edited.gear);

    await page.goto(`${base}/#/assets/${id}-copy/settings`);
    await page.getByText("Delete this asset").click();
    const remove = page.getByRole("button", { name: "Delete asset" });
    assert.ok(await remove.isDisabled());
    await page.getByLabel(`Type ${id}-copy to delete it`).fill(`${id}-copy`);
    await remove.click();
    await page.locator("h1", { hasText: "Fleet" }).waitFor();
    assert.equal((await json(`assets/${id}-copy`)).status, 404);
    await removeAsset(id);
    await close(opened, name);
  },

  "empty bores have a default that follows from the teeth": async (name) => {
    const id = `bores-${Date.now()}`;
    const opened = await open("#/new");
    const { page } = opened;
    const { "Bore radius, driving (mm)": _, "Bore radius, driven (mm)": __, ...numbers } = NUMBERS;
    const [driving, driven] = ["driving", "driven"].map((gear) => field(page, `Bore radius, ${gear} (mm)`));
    await driving.getByText("Default: a third of the root radius.").waitFor();
    await fill(page, { Name: id, ...numbers });
    // root radii: half the teeth less 1.25, in modules
    await driving.getByText("Default: a third of the root radius, 2.9 mm.").waitFor();
    await driven.getByText("Default: a third of the root radius, 6.3 mm.").waitFor();
    await page.locator(".measures li", { hasText: "Contact ratio" }).waitFor();
    await shoot(page, name);
    const created = async (bores) => {
      await page.getByRole("button", { name: "Create asset" }).click();
      await page.getByText("Waiting for the first record").waitFor();
      assert.deepEqual((await json(`assets/${id}`)).gear.pair.geometry.bore_radius_mm, bores);
      await removeAsset(id);
    };
    await created(undefined);
    await page.goto(`${base}/#/new`);
    await fill(page, { Name: id, ...numbers, "Bore radius, driven (mm)": "5" });
    await created([2.9, 5]);
    await close(opened, name);
  },

  "an impossible value is reported at its field and drawn red": async (name) => {
    const opened = await open("#/new");
    const { page } = opened;
    await fill(page, NUMBERS);
    await page.locator(".measures li").first().waitFor();
    await fill(page, { "Teeth, driving": "11", "Bore radius, driving (mm)": "4.5" });
    await field(page, "Bore radius, driving (mm)")
      .getByText(/^Bore radius, driving: expected at most 3\.\d+/)
      .waitFor();
    assert.equal(
      await page.getByLabel("Bore radius, driving (mm)", { exact: true }).getAttribute("aria-invalid"),
      "true",
    );
    assert.equal(
      await page.getByLabel("Bore radius, driven (mm)", { exact: true }).getAttribute("aria-invalid"),
      null,
    );
    for (const quantity of ["undercut_margin", "root_to_bore"])
      await page.locator(`.measures [data-quantity="${quantity}"][data-verdict="impossible"]`).waitFor();
    assert.ok((await page.locator(".pair-drawing .drawn-bad").count()) > 0);
    await shoot(page, `${name} impossible`);
    await fill(page, { Name: "Lüfter 2", "Driving shaft speed (rpm)": "9999999" });
    assert.equal(await page.locator("#setup-id").inputValue(), "lufter-2");
    await field(page, "Driving shaft speed (rpm)")
      .getByText("expected a number above 0 and at most 600000 rpm")
      .waitFor();
    await fill(page, {
      "Driving shaft speed (rpm)": "998.4",
      "Teeth, driving": "20",
      "Bore radius, driving (mm)": "3",
      "Danger (µm)": "10",
      "Warning (µm)": "50",
      Id: "Not An Id",
    });
    await field(page, "Warning (µm)")
      .getByText("Warning: expected a depth at or below the danger limit")
      .waitFor();
    await field(page, "Id").getByText("Id: expected 1 to 64 characters").waitFor();
    await fill(page, { Id: asset, "Danger (µm)": "60", "Module (mm)": "" });
    await page.getByRole("button", { name: "Create asset" }).click();
    await field(page, "Module (mm)").getByText("Module: required").waitFor();
    await fill(page, { "Module (mm)": "1", "Danger (µm)": "" });
    await page.getByLabel("Danger (µm)", { exact: true }).pressSequentially("6e");
    await page.getByRole("button", { name: "Create asset" }).click();
    await page.getByText("Not saved. Check the highlighted field.").waitFor();
    await field(page, "Danger (µm)").getByText("Danger: expected a number").waitFor();
    assert.ok(await field(page, "Id").getByText("expected an unused id").isHidden(), "nothing was sent");
    await fill(page, { "Danger (µm)": "60" });
    await page.getByRole("button", { name: "Create asset" }).click();
    await field(page, "Id").getByText("Id: expected an unused id").waitFor();
    // the browser logs the expected error response
    assert.deepEqual(
      opened.faults.filter((fault) => !fault.includes("409")),
      [],
    );
    await page.context().close();
  },

  "the wear slider moves teeth and curves": async (name) => {
    const opened = await open("#/new");
    const { page } = opened;
    await page.getByLabel("Gear pair, for wear in µm").selectOption("shen2022");
    await worn(page);
    for (const kind of ["harmonics", "stiffness", "transmission", "preview-waveform", "preview-spectrum"])
      await drawn(page, kind);
    const [times, answers] = [[], []];
    page.on("response", (answer) => answer.url().endsWith("/v1/preview") && answers.push(answer));
    for (const part of [0.2, 0.5, 0.8, 1, 0.7, 0.4, 0.1, 0.3, 0.6]) {
      const began = Date.now();
      await slide(page, "wear", part);
      await page.waitForFunction(
        (wear) => Math.abs(Number(document.querySelector(".preview").dataset.wear) - wear) < 1,
        245 * part,
      );
      times.push(Date.now() - began);
    }
    say("a step of the wear slider, from the hand to the last curve", times, 100);
    // the moved line is the worn one, also in hover text
    const { model } = await answers.at(-1).json();
    const stiffness = model.worn.stiffness_n_per_m.map((value) => value * 1e-6);
    const shown = await page.evaluate(() => {
      const plot = document.querySelector('[data-plot="stiffness"] .plot');
      const lines = plot.querySelectorAll(".scatterlayer .trace");
      const path = [...lines].at(-1).querySelector(".js-line").getAttribute("d");
      const last = path.split(/[LM]/).at(-1).split(",").map(Number);
      return { count: lines.length, last: plot._fullLayout.yaxis.p2d(last[1]) };
    });
    assert.equal(shown.count, 2);
    const span = Math.max(...stiffness) - Math.min(...stiffness);
    assert.ok(Math.abs(shown.last - stiffness.at(-1)) < 0.01 * span, `${shown.last} ${stiffness.at(-1)}`);
    await page.waitForFunction(
      (value) =>
        Math.abs(document.querySelector('[data-plot="stiffness"] .plot').data.at(-1).y.at(-1) - value) < 1e-9,
      stiffness.at(-1),
    );
    assert.ok(
      (await page.locator(".preview .mesh-lost").count()) === 2,
      "what is lost is drawn on both gears",
    );
    const before = await page.locator(".preview-facts").innerText();
    await slide(page, "speed", 0.9);
    await page.waitForFunction((text) => document.querySelector(".preview-facts").innerText !== text, before);
    const angle = () =>
      page.locator(".preview .mesh-driving").evaluate((path) => path.parentElement.getAttribute("transform"));
    const still = await angle();
    await page.getByRole("button", { name: "Roll teeth" }).click();
    await page.waitForFunction(
      (text) =>
        document.querySelector(".preview .mesh-driving").parentElement.getAttribute("transform") !== text,
      still,
    );
    await page.getByRole("button", { name: "Stop" }).click();
    await close(opened, name);
  },

  "every value of a description has a field, rare ones folded away": async (name) => {
    const api = await (await fetch(`${base}/openapi.json`)).json();
    const leaves = new Set();
    const walk = (schema, path) => {
      if (schema.$ref) return walk(api.components.schemas[schema.$ref.split("/").at(-1)], path);
      const parts = [schema.oneOf, schema.anyOf, schema.allOf].flatMap((all) => all ?? []);
      for (const part of parts.filter(({ type }) => type !== "null")) walk(part, path);
      for (const [key, inner] of Object.entries(schema.properties ?? {}))
        walk(inner, path ? `${path}.${key}` : key);
      if (schema.items) walk(schema.items, `${path}.0`);
      else if (!parts.length && !schema.properties) leaves.add(path);
    };
    walk(api.paths["/v1/assets"].post.requestBody.content["application/json"].schema, "");
    // a rule between fields names whole objects, whose values stand elsewhere in the schema
    for (const path of [...leaves])
      if ([...leaves].some((other) => other.startsWith(`${path}.`))) leaves.delete(path);
    const opened = await open("#/new");
    const { page } = opened;
    const fields = await page.evaluate(async () => {
      const { SETUP_FIELDS } = await import(new URL("static/setup-fields.js", document.baseURI).href);
      return SETUP_FIELDS.flatMap(({ path, alike }) => [path, alike ?? path]);
    });
    const known = fields.map((path) => path.replaceAll(/\.\d+/g, ".0"));
    // alarm rules and operating bins have rows of their own, tested below; measured wear is given as a table
    const elsewhere = /^(alarms|operating_bins|gear\.pair\.wear\.table)\./;
    // a list in the description has fields for a second entry, but for those of fixed length
    const lists = new Set([...leaves].flatMap((leaf) => /^(.*?)\.0\.[a-z]/.exec(leaf)?.[1] ?? []));
    const growing = await page.evaluate(async () => {
      const { LIST_PATHS } = await import(new URL("static/setup-lists.js", document.baseURI).href);
      return LIST_PATHS;
    });
    assert.deepEqual([...lists].filter((list) => !elsewhere.test(`${list}.`)).sort(), growing.toSorted());
    assert.ok(leaves.size > 60, `${leaves.size} values`);
    assert.deepEqual(
      [...leaves].filter((leaf) => !known.includes(leaf) && !elsewhere.test(leaf)),
      [],
    );

    const id = `rare-${Date.now()}`;
    await page.getByLabel("Gear pair, for wear in µm").selectOption({ label: "None: indicators only" });
    await fill(page, {
      Name: id,
      "Teeth, driving": "31",
      "Teeth, driven": "62",
      "Driving shaft speed (rpm)": "600",
    });
    for (const summary of [/^Unit and calibration of the channel/, /^Custom zone limits/])
      await page.locator("summary", { hasText: summary }).click();
    await fill(page, {
      "Zone A to (mm/s)": "1",
      "Zone B to (mm/s)": "2",
      "Zone C to (mm/s)": "3",
      "Envelope band from (Hz)": "500",
      "Name of a custom band": "low",
      "Custom band from (Hz)": "10",
      "Other mesh: driving teeth": "19",
      "Other mesh: driven teeth": "57",
      "Ratio of its driving shaft to the measured one: driving teeth": "24",
    });
    await page.getByLabel("Quantity in the band").selectOption("velocity");
    await page.getByLabel("Omit order-tracked gear indicators").check();
    // values that belong together report the empty field
    await field(page, "Custom band to (Hz)").getByText("Custom band to: expected a value").waitFor();
    await field(page, "Envelope band to (Hz)").getByText("expected a value").waitFor();
    await fill(page, { "Custom band to (Hz)": "1000", "Envelope band to (Hz)": "100" });
    const save = page.getByRole("button", { name: "Create asset" });
    await save.click();
    await field(page, "Envelope band from (Hz)")
      .getByText("Envelope band from: expected two frequencies from 0 to 1e7, the lower one first")
      .waitFor();
    await fill(page, { "Envelope band to (Hz)": "1500" });
    await save.click();
    await page.waitForURL((url) => url.hash === `#/assets/${id}`);
    const made = await json(`assets/${id}`);
    assert.deepEqual(
      [made.velocity_zones, made.envelope_band_hz, made.gear_indicators, made.bands, made.gear.other_meshes],
      [
        { limits_mm_per_s: [1, 2, 3] },
        [500, 1500],
        false,
        [{ name: "low", band_hz: [10, 1000], quantity: "velocity" }],
        [{ teeth: [19, 57], shaft_ratio: [24, 1] }],
      ],
    );
    const again = await open(`#/new?edit=${id}`);
    await again.page.locator("#setup-bands-0-band-hz-1").waitFor({ state: "attached" });
    await again.page.waitForFunction(
      () => document.querySelector("#setup-bands-0-band-hz-1").value === "1000",
    );
    assert.ok(await again.page.locator("#setup-gear-indicators").isChecked());
    assert.equal(await again.page.locator("#setup-json").inputValue(), "", "nothing is left for the JSON");
    await close(again, `${name} again`);
    opened.faults.splice(
      0,
      opened.faults.length,
      ...opened.faults.filter((fault) => !fault.includes(" 422 ")),
    );
    await close(opened, name);
    await removeAsset(id);
  },

  "several points, bearings, bands and meshes are entered, with alarms and bins": async (name) => {
    const id = `several-${Date.now()}`;
    const opened = await open("#/new");
    const { page } = opened;
    await page.getByLabel("Gear pair, for wear in µm").selectOption({ label: "None: indicators only" });
    await fill(page, {
      Name: id,
      "Teeth, driving": "31",
      "Teeth, driven": "62",
      "Driving shaft speed (rpm)": "600",
    });
    await page.locator("summary", { hasText: /^Unit and calibration of the channel/ }).click();
    await page.locator("summary", { hasText: /^Fault frequencies/ }).click();
    for (const word of ["bearing", "bearing", "measuring point", "custom band", "mesh on the machine"])
      await page.getByRole("button", { name: `Add another ${word}` }).click();
    const values = {
      Bearing: "drive_end",
      "Rolling elements": "9",
      "Rolling element diameter (mm)": "7.94",
      "Pitch diameter (mm)": "39.04",
      "Bearing 2": "gone",
      "Rolling elements 2": "8",
      "Bearing 3": "fan_end",
      "Outer race (BPFO) 3 (orders)": "3.1",
      "Inner race (BPFI) 3 (orders)": "4.9",
      "Rolling element (BSF) 3 (orders)": "2.2",
      "Cage (FTF) 3 (orders)": "0.38",
      Channel: "housing",
      "Serial number 2": "7",
      "Name of a custom band": "low",
      "Custom band from (Hz)": "10",
      "Custom band to (Hz)": "100",
      "Name of a custom band 2": "high",
      "Custom band from 2 (Hz)": "900",
      "Custom band to 2 (Hz)": "200",
      "Other mesh: driving teeth": "19",
      "Other mesh: driven teeth": "57",
      "Other mesh: driving teeth 2": "17",
      "Other mesh: driven teeth 2": "51",
    };
    // a serial number is of a point in the folded part
    await page.locator("summary", { hasText: /^Position, serial number/ }).click();
    await fill(page, values);
    await field(page, "Channel 2").getByText("Channel 2: expected a name, as its sensor has data").waitFor();
    await fill(page, { "Channel 2": "bearing" });
    // the third bearing becomes the second
    await page.getByRole("button", { name: "Remove bearing 2" }).click();
    assert.equal(await page.getByLabel("Bearing 2", { exact: true }).inputValue(), "fan_end");
    await page.getByText("Alarm rules and operating bins", { exact: true }).click();
    await page.getByLabel("Custom rules").check();
    await page.getByRole("button", { name: "Add rule" }).click();
    await page.getByLabel("Indicator", { exact: true }).fill("kurtosis");
    await page.getByLabel("Warning above").fill("4");
    await page.getByRole("button", { name: "Add operating bin" }).click();
    await page.locator(".setup-rules").getByLabel("Name", { exact: true }).fill("full load");
    await page.getByLabel("Torque from (N·m)").fill("80");
    await page.locator(".setup-rules").getByLabel("up to").last().fill("120");
    await shoot(page, name);
    const save = page.getByRole("button", { name: "Create asset" });
    await save.click();
    // the second band alone is refused
    await field(page, "Custom band from 2 (Hz)")
      .getByText(/Custom band from 2: expected .* the lower one first/)
      .waitFor();
    assert.equal(
      await page.getByLabel("Custom band from (Hz)", { exact: true }).getAttribute("aria-invalid"),
      null,
    );
    await fill(page, { "Custom band to 2 (Hz)": "1800" });
    await page.getByLabel("Warning above").fill("");
    await save.click();
    await page.locator(".setting-list", { hasText: "expected a warning or a danger level" }).waitFor();
    await page.getByLabel("Warning above").fill("4");
    await save.click();
    await page.waitForURL((url) => url.hash === `#/assets/${id}`);
    const made = await json(`assets/${id}`);
    assert.deepEqual(
      made.bearings.map(({ name, rolling_elements: balls, orders }) => [name, balls, orders?.bpfo]),
      [
        ["drive_end", 9, undefined],
        ["fan_end", undefined, 3.1],
      ],
    );
    assert.deepEqual(
      [
        made.points.map(({ channel, serial }) => [channel, serial]),
        made.bands.map(({ name, band_hz: band }) => [name, band]),
        made.gear.other_meshes.map(({ teeth }) => teeth),
        made.alarms.map(({ quantity, warning }) => [quantity.indicator, warning]),
        made.operating_bins.map(({ name }) => name),
      ],
      [
        [
          ["housing", undefined],
          ["bearing", "7"],
        ],
        [
          ["low", [10, 100]],
          ["high", [900, 1800]],
        ],
        [
          [19, 57],
          [17, 51],
        ],
        [["kurtosis", 4]],
        ["full load"],
      ],
    );
    await page.goto(`${base}/#/new?edit=${id}`);
    await page.getByLabel("Bearing 2", { exact: true }).waitFor();
    assert.equal(await page.locator("#setup-json").inputValue(), "", "nothing is left for the JSON");
    await page.getByRole("button", { name: "Save asset" }).click();
    await page.waitForURL((url) => url.hash === `#/assets/${id}`);
    const { updated_at: _, revision: __, summary: ___, ...again } = await json(`assets/${id}`);
    for (const key of ["bearings", "points", "bands", "gear", "alarms", "operating_bins"])
      assert.deepEqual(again[key], made[key], key);
    await page.context().close();
    await removeAsset(id);
  },

  "the wear preview is a page of an asset, also on a phone": async (name) => {
    for (const [size, options] of Object.entries({
      desk: { viewport: { width: 1440, height: 900 } },
      phone: PHONE,
    })) {
      const opened = await open(`#/assets/${asset}/wear`, options);
      await worn(opened.page);
      await drawn(opened.page, "preview-spectrum");
      await noSidewaysScrolling(opened.page);
      await close(opened, `${name} ${size}`);
    }
    if (!shots) return;
    for (const [width, colorScheme] of [
      [1440, "light"],
      [1440, "dark"],
      [1280, "light"],
      [390, "light"],
      [390, "dark"],
    ]) {
      const opened = await open("#/new", { viewport: { width, height: 900 }, colorScheme });
      await opened.page.getByLabel("Gear pair, for wear in µm").selectOption("shen2022");
      await worn(opened.page);
      await drawn(opened.page, "preview-spectrum");
      await opened.page.waitForTimeout(300);
      await noSidewaysScrolling(opened.page);
      await close(opened, `new asset ${width} ${colorScheme}`);
    }
  },
};
