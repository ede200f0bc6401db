// The bench: overlaid records, quantities, bearings, the list of largest lines, audio, links.

import assert from "node:assert/strict";
import {
  asset,
  base,
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
  sendRecord,
  shownTime,
} from "./page.mjs";

/** A number of records of the asset, evenly spaced over its history. */
async function records(count) {
  const { items } = await json(`assets/${asset}/segments?limit=1000&order=asc`);
  return Array.from(
    { length: count },
    (_, n) => items[Math.round((n * (items.length - 1)) / Math.max(1, count - 1))],
  );
}

const whole = async (id, kind = "spectrum") => json(`segments/${id}/${kind}?max_points=200000`);
const address = (items, query = "") => `#/bench?records=${items.map(({ id }) => id).join(",")}&${query}`;
const curves = (page, kind) =>
  page.evaluate(
    (key) =>
      document
        .querySelector(`[data-plot="${key}"] .plot`)
        .data.filter(({ mode }) => mode.startsWith("lines"))
        .map(({ x, y, line }) => ({ x: Array.from(x), y: Array.from(y), colour: line.color })),
    kind,
  );
const rows = (page, selector) =>
  page
    .locator(`${selector} tbody tr`)
    .evaluateAll((list) => list.map((row) => [...row.children].map((cell) => cell.textContent)));

/** Sends a record of two tones, 1 m/s² at 100 Hz and 0.5 m/s² at 5 Hz, in whole periods. */
async function sendTones(id, minute, unit = "m/s2", scale = 1, channel = "a1") {
  const samples = Array.from(
    { length: 8000 },
    (_, n) =>
      scale * (Math.sin((2 * Math.PI * 100 * n) / 4000) + 0.5 * Math.sin((2 * Math.PI * 5 * n) / 4000)),
  );
  return sendRecord(id, { start_time: `2026-03-01T08:${minute}:00Z`, unit, channel, samples });
}

/** The value of a curve at a position. */
function heightAt({ x, y }, place) {
  const nearest = x.reduce(
    (best, value, n) => (Math.abs(value - place) < Math.abs(x[best] - place) ? n : best),
    0,
  );
  return Math.max(...y.slice(Math.max(0, nearest - 1), nearest + 2));
}

async function tones(unit, scale) {
  const id = await createAsset("tones");
  await sendTones(id, "10", unit, scale);
  const { items } = await json(`assets/${id}/segments`);
  return { id, items };
}

export const CHECKS = {
  "two records are overlaid in every view": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "show=waveform,spectrum,envelope,turn,cepstrum"));
    const { page } = opened;
    for (const kind of ["waveform", "spectrum", "envelope", "turn", "cepstrum"]) {
      await drawn(page, kind);
      const lines = await curves(page, kind);
      assert.equal(lines.length, 2, kind);
      assert.notEqual(lines[0].colour, lines[1].colour, `${kind}: a colour for each`);
      const legend = page.locator(`[data-plot="${kind}"] .legend`);
      for (const { start_time: start, channel } of chosen)
        await legend.getByText(`${channel} · ${shownTime(start)}`).waitFor();
    }
    const lanes = await page.evaluate(() =>
      document
        .querySelector('[data-plot="waveform"] .plot')
        .data.map(({ yaxis, line }) => [yaxis ?? "y", line.color]),
    );
    const [{ colour: below }, { colour: first }] = await curves(page, "spectrum");
    assert.deepEqual(
      lanes,
      [
        ["y", first],
        ["y2", below],
      ],
      "the first waveform is in the upper lane",
    );
    // the second record is drawn first, below; the drawing matches the server's data
    const [second] = await curves(page, "cepstrum");
    const { value } = await json(`segments/${chosen[1].id}/cepstrum?max_points=4000&max_s=0.2`);
    assert.deepEqual(second.y, value);
    await page
      .getByRole("button", { name: /^Remove: .*/ })
      .last()
      .click();
    await page.waitForFunction((id) => !location.hash.includes(id), chosen[1].id);
    await page.waitForFunction(
      () => document.querySelector('[data-plot="waveform"] .plot').data.length === 1,
    );
    await close(opened, name);
  },

  "records are added to the bench from their page, the table and the bench": async (name) => {
    const chosen = await records(3);
    const opened = await open(`#/assets/${asset}?segment=${chosen[1].id}`);
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.getByRole("button", { name: "Compare…" }).click();
    await page.waitForFunction(() => location.hash.startsWith("#/bench"));
    assert.equal(parameters(page).get("records"), chosen[1].id);
    await page.goto(`${base}/#/assets/${asset}/records?order=asc`);
    await page.locator(`[data-record="${chosen[0].id}"] input`).check();
    await page.getByRole("button", { name: "Compare…" }).click();
    await page.waitForFunction(() => location.hash.startsWith("#/bench"));
    assert.equal(parameters(page).get("records"), `${chosen[1].id},${chosen[0].id}`);
    await page.getByRole("combobox", { name: "Asset", exact: true }).selectOption(asset);
    await page.locator(`#bench-record option[value="${chosen[2].id}"]`).waitFor({ state: "attached" });
    await page.getByRole("combobox", { name: "Record", exact: true }).selectOption(chosen[2].id);
    await page.getByRole("button", { name: "Add", exact: true }).click();
    await page.locator(`.bench-records [data-record="${chosen[2].id}"]`).waitFor();
    assert.equal(parameters(page).get("records"), [1, 0, 2].map((n) => chosen[n].id).join(","));
    await page
      .getByRole("button", { name: /^Make first: / })
      .last()
      .click();
    await page.waitForFunction((id) => location.hash.includes(`records=${id}`), chosen[2].id);
    await close(opened, name);
  },

  "velocity and displacement are the acceleration over 2πf once and twice": async (name) => {
    const { id, items } = await tones();
    for (const [quantity, shown, expected] of [
      ["velocity", "mm/s", 1e3 / (2 * Math.PI * 100)],
      ["displacement", "µm", 1e6 / (2 * Math.PI * 100) ** 2],
    ]) {
      const opened = await open(address(items, `quantity=${quantity}`));
      const { page } = opened;
      await drawn(page, "spectrum");
      await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: `in ${shown}` }).waitFor();
      await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "from 10 Hz" }).waitFor();
      const [line] = await curves(page, "spectrum");
      const height = heightAt(line, 100);
      assert.ok(
        Math.abs(height / expected - 1) < 1e-3,
        `${quantity}: ${height}, expected ${expected} ${shown}`,
      );
      assert.ok(
        line.x.every((hz, n) => hz >= 10 || line.y[n] === null),
        "nothing below the cut-off",
      );
      // with a cut-off of 2 Hz, the 5 Hz tone is present
      await page.getByRole("combobox", { name: "From", exact: true }).selectOption("2");
      await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "from 2 Hz" }).waitFor();
      const order = quantity === "velocity" ? 1 : 2;
      const low = (0.5 * (quantity === "velocity" ? 1e3 : 1e6)) / (2 * Math.PI * 5) ** order;
      const read = heightAt((await curves(page, "spectrum"))[0], 5);
      assert.ok(Math.abs(read / low - 1) < 1e-3, `${read}, expected ${low} ${shown}`);
      await close(opened, `${name} ${quantity}`);
      const waveform = await open(address(items, `show=waveform&quantity=${quantity}`));
      await drawn(waveform.page, "waveform");
      await waveform.page.locator('[data-plot="waveform"] .plot-sub', { hasText: "from 10 Hz" }).waitFor();
      const peak = Math.max(...(await curves(waveform.page, "waveform"))[0].y);
      assert.ok(Math.abs(peak / expected - 1) < 0.01, `${peak}, expected ${expected} ${shown}`);
      await close(waveform, `${name} ${quantity} waveform`);
    }
    await removeAsset(id);
  },

  "levels are in dB re 1 µm/s² or relative to the first record": async (name) => {
    const id = await createAsset("levels");
    await sendTones(id, "10");
    await sendTones(id, "20", "m/s2", 4);
    const { items } = await json(`assets/${id}/segments?order=asc`);
    const opened = await open(address(items, "scale=db"));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "0 dB is 10⁻⁶ m/s²" }).waitFor();
    const [louder, first] = await curves(page, "spectrum");
    assert.ok(Math.abs(heightAt(first, 100) - 120) < 0.05, `${heightAt(first, 100)} dB`);
    assert.ok(Math.abs(heightAt(louder, 100) - 132.04) < 0.05, `${heightAt(louder, 100)} dB`);
    await page.getByRole("combobox", { name: "Amplitude", exact: true }).selectOption("change");
    await page
      .locator('[data-plot="spectrum"] .plot-sub', { hasText: "relative to the first record" })
      .waitFor();
    const [changed, none] = await curves(page, "spectrum");
    assert.ok(Math.abs(heightAt(changed, 100) - 12.04) < 0.05, `${heightAt(changed, 100)} dB`);
    assert.ok(none.y.every((level) => level === null || level === 0));
    await close(opened, name);
    await removeAsset(id);
  },

  "records in g and in m/s² are shown in one unit": async (name) => {
    const { id, items } = await tones("g", 1);
    const opened = await open(address(items));
    await drawn(opened.page, "spectrum");
    const [line] = await curves(opened.page, "spectrum");
    assert.ok(Math.abs(heightAt(line, 100) / 9.80665 - 1) < 1e-3, `${heightAt(line, 100)} m/s²`);
    await close(opened, name);
    await removeAsset(id);
  },

  "records of two assets, channels and units are overlaid": async (name) => {
    const first = await createAsset("left", {});
    const second = await createAsset("right", { sensor: { unit: "mm/s" } });
    await sendTones(first, "10", "m/s2", 2, "housing");
    await sendTones(second, "20", "mm/s", 3, "bearing");
    const items = (
      await Promise.all([first, second].map(async (id) => (await json(`assets/${id}/segments`)).items))
    ).flat();
    const opened = await open(address(items));
    const { page } = opened;
    await drawn(page, "spectrum");
    for (const [asset, channel] of [
      [first, "housing"],
      [second, "bearing"],
    ])
      await page
        .locator('[data-plot="spectrum"] .legend', { hasText: `${asset} · ${channel} · 2026-03-01` })
        .waitFor();
    const near = (read, expected) =>
      assert.ok(Math.abs(read / expected - 1) < 1e-3, `${read}, expected ${expected}`);
    // the second record, drawn first, is a velocity: its acceleration is 2πf times that
    const omega = 2 * Math.PI * 100;
    const [other, own] = await curves(page, "spectrum");
    near(heightAt(own, 100), 2);
    near(heightAt(other, 100), 3e-3 * omega);
    await page.getByRole("combobox", { name: "Quantity", exact: true }).selectOption("velocity");
    await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "Velocity in mm/s" }).waitFor();
    const [moved, divided] = await curves(page, "spectrum");
    near(heightAt(divided, 100), (1e3 * 2) / omega);
    near(heightAt(moved, 100), 3);
    await page.getByRole("button", { name: "Waveform" }).click();
    await drawn(page, "waveform");
    await close(opened, name);
    for (const id of [first, second]) await removeAsset(id);
  },

  "a logarithmic amplitude keeps the values and spans decades": async (name) => {
    const { id, items } = await tones();
    const opened = await open(address(items));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.getByRole("combobox", { name: "Amplitude", exact: true }).selectOption("log");
    await page.waitForFunction(
      () => document.querySelector('[data-plot="spectrum"] .plot')._fullLayout.yaxis.type === "log",
    );
    const [line] = await curves(page, "spectrum");
    assert.ok(Math.abs(heightAt(line, 100) - 1) < 1e-3, `${heightAt(line, 100)} m/s²`);
    assert.ok(Math.abs(heightAt(line, 5) - 0.5) < 1e-3, `${heightAt(line, 5)} m/s²`);
    const [low, high] = await page.evaluate(
      () => document.querySelector('[data-plot="spectrum"] .plot')._fullLayout.yaxis.range,
    );
    assert.ok(low < -1 && high > 0 && high < 1, `from 10^${low} to 10^${high}`);
    assert.equal(parameters(page).get("scale"), "log");
    await page.reload();
    await drawn(page, "spectrum");
    assert.equal(
      await page.evaluate(
        () => document.querySelector('[data-plot="spectrum"] .plot')._fullLayout.yaxis.type,
      ),
      "log",
    );
    await close(opened, name);
    await removeAsset(id);
  },

  "a bearing's cursor stands at the orders of its geometry": async (name) => {
    const [record] = await records(1);
    const opened = await open(address([record], "show=spectrum,envelope&axis=orders&band=0~20&eband=0~20"));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.getByRole("combobox", { name: "Bearing", exact: true }).selectOption("6205");
    const table = '[data-plot="spectrum"] details.lines';
    await page.locator(`${table} tbody tr`, { hasText: "BPFI" }).first().waitFor();
    const orders = Object.fromEntries(
      (await rows(page, table)).map(([line, order]) => [line, Number(order)]),
    );
    // 9 balls of 7.94 mm on 39.04 mm, as published for this bearing
    for (const [line, published] of Object.entries({
      BPFO: 3.5848,
      BPFI: 5.4152,
      BSF: 4.7135 / 2,
      FTF: 0.39828,
    }))
      assert.ok(
        Math.abs(orders[line] - published) < 1e-3,
        `${line} at ${orders[line]}, published ${published}`,
      );
    const places = await page.evaluate(() => {
      const plot = document.querySelector('[data-plot="envelope"] .plot');
      return [...document.querySelectorAll('[data-plot="envelope"] .cursor-line')].map((line) =>
        plot._fullLayout.xaxis.p2l(parseFloat(line.style.left)),
      );
    });
    for (const order of [3.5848, 5.4152, 2 * 3.5848])
      assert.ok(
        places.some((place) => Math.abs(place - order) < 0.01),
        `${order} in ${places}`,
      );
    // another geometry
    await page.getByRole("combobox", { name: "Bearing", exact: true }).selectOption("g");
    await page.getByLabel("Rolling elements").fill("16");
    await page.getByLabel("Rolling element diameter, mm").fill("8.407");
    await page.getByLabel("Pitch diameter, mm").fill("71.501");
    await page.getByLabel("Contact angle, °").fill("15.17");
    await page.getByLabel("Contact angle, °").press("Enter");
    await page.locator(".bench-bearing", { hasText: "BPFO 7.092" }).waitFor();
    await page.getByLabel("Rolling elements").fill("1.5");
    await page.getByLabel("Rolling elements").press("Enter");
    await page.getByText("enter a whole number from 2 to 1000").waitFor();
    await close(opened, name);
  },

  "a bearing of the asset is offered": async (name) => {
    const id = await createAsset("bearings", {
      bearings: [{ name: "drive_end", orders: { bpfo: 3.1, bpfi: 4.9, bsf: 2.2, ftf: 0.38 } }],
    });
    await sendTones(id, "10");
    const { items } = await json(`assets/${id}/segments`);
    const opened = await open(address(items, "speed=10&band=0~100"));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page
      .getByRole("combobox", { name: "Bearing", exact: true })
      .selectOption({ label: `${id}: drive_end` });
    await page.locator(".cursor-readout", { hasText: "BPFO 31 Hz" }).first().waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "the average is that of the selected gear": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "show=turn"));
    const { page } = opened;
    await drawn(page, "turn");
    const { gear } = await json(`assets/${asset}`);
    const choice = page.getByRole("combobox", { name: "Gear of the average", exact: true });
    await choice.selectOption({ label: `Driven gear, ${gear.teeth[1]} teeth` });
    const ofDriven = page.locator('[data-plot="turn"] .infolayer', { hasText: "Angle of the driven gear" });
    await ofDriven.waitFor();
    const expected = await Promise.all(chosen.map(({ id }) => json(`segments/${id}/turn?gear=2`)));
    // the first record is drawn last, on top
    const [second, first] = await curves(page, "turn");
    assert.deepEqual([first.y, second.y], [expected[0].average, expected[1].average]);
    await page.getByText(`One tooth is ${Number((360 / gear.teeth[1]).toPrecision(4))}°`).waitFor();
    const restored = await open(`#/assets/${asset}?show=turn&segment=${chosen[0].id}&gear=2`);
    await restored.page.getByText(`${expected[0].turns} turns of the driven gear averaged`).waitFor();
    await close(restored, `${name} on the record's page`);
    await close(opened, name);
  },

  "the averages of both gears are above one another": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "show=turn"));
    const { page } = opened;
    await drawn(page, "turn");
    await page
      .getByRole("combobox", { name: "Gear of the average", exact: true })
      .selectOption({ label: "Both gears" });
    for (const gear of ["driving", "driven"])
      await page.locator('[data-plot="turn"] .infolayer', { hasText: `Angle of the ${gear} gear` }).waitFor();
    const expected = await Promise.all(
      chosen.flatMap(({ id }) => [1, 2].map((gear) => json(`segments/${id}/turn?gear=${gear}`))),
    );
    const lines = await page.evaluate(() =>
      document
        .querySelector('[data-plot="turn"] .plot')
        .data.map(({ y, yaxis = "y" }) => ({ y: Array.from(y), yaxis })),
    );
    // the first record is drawn last, on top
    const [first, second] = [expected.slice(0, 2), expected.slice(2)];
    assert.deepEqual(
      lines,
      [...second, ...first].map(({ average, gear }) => ({ y: average, yaxis: gear === 2 ? "y2" : "y" })),
    );
    assert.equal(parameters(page).get("gear"), "both");
    const restored = await open(`#/assets/${asset}?show=turn&segment=${chosen[0].id}&gear=both`);
    const { driven, driving } = { driving: first[0], driven: first[1] };
    for (const words of [
      `${driving.turns} turns of the driving gear`,
      `${driven.turns} turns of the driven gear`,
    ])
      await restored.page.getByText(words).waitFor();
    await close(restored, `${name} on the record's page`);
    await close(opened, name);
  },

  "the largest lines are those of the spectrum at full resolution": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "band=1000~3000&peaks=5"));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.locator(".peak-list tbody tr").nth(9).waitFor();
    const shown = await rows(page, ".peak-list");
    assert.equal(shown.length, 10);
    const [first, second] = await Promise.all(chosen.map(({ id }) => whole(id)));
    for (const [index, full] of [first, second].entries()) {
      const { frequency_hz: x, amplitude: y, shaft_speed_hz: shaft } = full;
      const expected = x
        .map((hz, n) => ({ hz, n, height: y[n] }))
        .filter(({ hz, n }) => hz >= 1000 && hz <= 3000 && y[n] > y[n - 1] && y[n] >= y[n + 1])
        .sort((a, b) => b.height - a.height)
        .slice(0, 5);
      expected.forEach(({ hz, height }, row) => {
        const [, frequency, order, amplitude, level] = shown[5 * index + row];
        assert.equal(frequency, hz.toFixed(2));
        assert.equal(order, (hz / shaft).toFixed(3));
        assert.equal(Number(amplitude), Number(height.toPrecision(4)));
        if (index === 0) return assert.equal(level, "–");
        // the speeds differ a little, so the line of the same order is at another frequency
        const place = Math.round((hz * first.shaft_speed_hz) / shaft / first.resolution_hz);
        const reference = Math.max(...first.amplitude.slice(place - 1, place + 2));
        assert.ok(
          Math.abs(Number(level.replace("−", "-")) - 20 * Math.log10(height / reference)) < 0.06,
          level,
        );
      });
    }
    await close(opened, name);
  },

  "cursors read every record": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "cursor=h~400"));
    const { page } = opened;
    const table = '[data-plot="spectrum"] details.lines';
    await page.locator(`${table} tbody tr`).nth(3).waitFor();
    const [line] = await rows(page, table);
    const amplitudes = await Promise.all(
      chosen.map(async ({ id }) => {
        const { amplitude, resolution_hz: step } = await whole(id);
        const nearest = Math.round(400 / step);
        return Math.max(...amplitude.slice(nearest - 1, nearest + 2));
      }),
    );
    assert.deepEqual(
      [line[3], line[4]].map((cell) => Number(cell.replaceAll(/[()]/g, ""))), // in brackets: in the noise
      amplitudes.map((each) => Number(each.toPrecision(4))),
    );
    await close(opened, name);
  },

  "a link restores the view of the bench": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.getByLabel("Spectrum axis").selectOption("orders");
    await page.getByRole("combobox", { name: "Quantity", exact: true }).selectOption("velocity");
    await page.getByRole("combobox", { name: "Amplitude", exact: true }).selectOption("db");
    await page.getByRole("combobox", { name: "Bearing", exact: true }).selectOption("ZA2115");
    await page.getByRole("button", { name: "Envelope spectrum" }).click();
    await drawn(page, "envelope");
    await page.locator('[data-plot="envelope"] .cursor-readout', { hasText: "ZA-2115" }).waitFor();
    const restored = await open(new URL(page.url()).hash);
    await drawn(restored.page, "spectrum");
    await drawn(restored.page, "envelope");
    await restored.page.locator('[data-plot="envelope"] .cursor-readout', { hasText: "ZA-2115" }).waitFor();
    for (const kind of ["spectrum", "envelope"])
      assert.deepEqual(await curves(restored.page, kind), await curves(page, kind), kind);
    for (const [label, value] of [
      ["Spectrum axis", "orders"],
      ["Quantity", "velocity"],
      ["Amplitude", "db"],
      ["Bearing", "ZA2115"],
    ])
      assert.equal(
        await restored.page.getByRole("combobox", { name: label, exact: true }).inputValue(),
        value,
      );
    await close(restored, `${name} restored`);
    await close(opened, name);
  },

  "a zoom of the bench is in its address": async (name) => {
    const chosen = await records(1);
    const opened = await open(address(chosen));
    const { page } = opened;
    await drawn(page, "spectrum");
    const area = await page.locator('[data-plot="spectrum"] .nsewdrag').first().boundingBox();
    await page.mouse.move(area.x + 0.2 * area.width, area.y + 0.5 * area.height);
    await page.mouse.down();
    await page.mouse.move(area.x + 0.4 * area.width, area.y + 0.5 * area.height, { steps: 6 });
    await page.mouse.up();
    await page.waitForFunction(() => location.hash.includes("band="));
    const [from, to] = parameters(page).get("band").split("~").map(Number);
    await page.locator(".peak-list", { hasText: `Range: ${Number(from.toPrecision(5))} to` }).waitFor();
    assert.ok(to > 1.5 * from);
    await close(opened, name);
  },

  "a record is played and stopped": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen));
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.getByText("the level is not calibrated").waitFor();
    await page
      .getByRole("button", { name: /^Listen to: / })
      .first()
      .click();
    const stop = page.getByRole("button", { name: /^Stop: / });
    await stop.waitFor();
    await page.getByLabel("Playback speed").selectOption("0.5");
    await page.getByRole("button", { name: /^Listen to: / }).click();
    await counted(stop, 1); // one at a time
    await stop.click();
    await stop.waitFor({ state: "detached" });
    const { peak, mean } = await page.evaluate(async () => {
      const { normalised } = await import(new URL("static/listening.js", document.baseURI).href);
      const values = normalised(Float32Array.from({ length: 1000 }, (_, n) => 5 + 0.01 * Math.sin(n)));
      return {
        peak: values.reduce((most, value) => Math.max(most, Math.abs(value)), 0),
        mean: values.reduce((sum, value) => sum + value, 0) / values.length,
      };
    });
    assert.ok(Math.abs(peak - 0.9) < 1e-3 && Math.abs(mean) < 1e-2, `${peak}, ${mean}`);
    await close(opened, name);
  },

  "a picture of the bench is on white, even in the dark theme": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen), { colorScheme: "dark" });
    const { page } = opened;
    await drawn(page, "spectrum");
    const button = page.getByRole("button", { name: "Spectrum: save as PNG", exact: true });
    const [download] = await Promise.all([page.waitForEvent("download"), button.click()]);
    const chunks = [];
    for await (const chunk of await download.createReadStream()) chunks.push(chunk);
    const pixel = await page.evaluate(async (data) => {
      const image = new Image();
      image.src = `data:image/png;base64,${data}`;
      await image.decode();
      const context = new OffscreenCanvas(4, 4).getContext("2d");
      context.drawImage(image, 0, 0);
      return Array.from(context.getImageData(1, 1, 1, 1).data);
    }, Buffer.concat(chunks).toString("base64"));
    assert.deepEqual(pixel, [255, 255, 255, 255]);
    assert.match(download.suggestedFilename(), /^bench-spectrum-.*\.png$/);
    const csv = page.getByRole("button", { name: "Spectrum: save as CSV", exact: true });
    const [table] = await Promise.all([page.waitForEvent("download"), csv.click()]);
    const text = [];
    for await (const chunk of await table.createReadStream()) text.push(chunk);
    const lines = Buffer.concat(text).toString().split("\r\n");
    assert.equal(lines.filter((line) => line.startsWith("# Record: ")).length, 2);
    const head = lines.find((line) => !line.startsWith("#"));
    for (const { start_time: start, channel } of chosen)
      assert.ok(head.includes(`${channel} · ${shownTime(start)}: amplitude_peak (m/s2)`), head);
    await close(opened, name);
  },

  "a record that cannot be drawn is reported": async (name) => {
    const [record] = await records(1);
    const opened = await open(`#/bench?records=${record.id},no-such-record`);
    const { page } = opened;
    await drawn(page, "spectrum");
    await page.locator('.bench-records [data-record="no-such-record"]').waitFor();
    assert.equal((await curves(page, "spectrum")).length, 1);
    opened.faults.splice(0, opened.faults.length, ...opened.faults.filter((fault) => !fault.includes("404")));
    await close(opened, name);
  },

  "the bench fits a phone": async (name) => {
    const chosen = await records(2);
    const opened = await open(address(chosen, "show=spectrum,waveform&cursor=b&bearing=6205"), PHONE);
    await drawn(opened.page, "waveform");
    await noSidewaysScrolling(opened.page);
    await close(opened, name);
  },
};
