// Selecting a record, its views, cursors and comparison, all restored by a link.

import assert from "node:assert/strict";
import {
  asset,
  createAsset,
  close,
  drawn,
  json,
  open,
  overviewDrawn,
  parameters,
  plotOf,
  recordShown,
  removeAsset,
  sendNoise,
  shownTime,
} from "./page.mjs";

const selectedTime = (page) => page.locator(".record-bar h2").textContent();
const readout = (page) => page.locator(".cursor-readout:visible");

export const CHECKS = {
  "a bearing's lines are marked in the spectrum and the envelope of a record": async (name) => {
    const orders = { bpfo: 3.1, bpfi: 4.9, bsf: 2.2, ftf: 0.38 };
    const id = await createAsset("bearing", { bearings: [{ name: "drive_end", orders }] });
    await sendNoise(id, 1);
    const [{ shaft_speed: speed }] = (await json(`assets/${id}/segments`)).items;
    const opened = await open(`#/assets/${id}`);
    const { page } = opened;
    await drawn(page, "envelope");
    const bearing = page.getByRole("combobox", { name: "Bearing", exact: true });
    assert.ok(await bearing.isHidden());
    const [, end] = await plotOf(page, "envelope").evaluate((plot) => plot._fullLayout.xaxis.range);
    const highest = orders.bpfi * speed.shaft_speed_hz;
    assert.ok(end > 1.2 * highest && end < 2 * highest, `the bearing's lines fill the plot: to ${end} Hz`);
    await page.getByLabel("Cursor of the envelope").selectOption("b");
    // the asset's own bearing comes first
    const expected = orders.bpfo * speed.shaft_speed_hz;
    const table = '[data-plot="envelope"] .lines tbody tr';
    const row = page.locator(table).filter({ has: page.getByText("BPFO", { exact: true }) });
    await row.waitFor();
    const cells = await row.locator("th, td").allTextContents();
    assert.ok(Math.abs(cells[2] - expected) < 1e-3 * expected, `${cells}, expected ${expected} Hz`);
    assert.equal(await bearing.locator("option:checked").textContent(), `${id}: drive_end`);
    await page.getByLabel("Cursor", { exact: true }).selectOption("b");
    await page.locator('[data-plot="spectrum"] .cursor-readout', { hasText: "BPFO" }).waitFor();
    await close(opened, name);
    await removeAsset(id);
    // without a bearing of its own, an asset starts with a known one
    const other = await open(`#/assets/${asset}?axis=orders`);
    await drawn(other.page, "spectrum");
    await other.page.getByLabel("Cursor", { exact: true }).selectOption("b");
    await other.page.locator(".cursor-readout", { hasText: "6205" }).waitFor();
    await other.page.locator(".bench-bearing", { hasText: "BPFO 3.5848" }).waitFor();
    await close(other, `${name} in orders`);
  },

  "a click on a record selects it, and the link restores it": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    // Plotly distinguishes clicking from pointing
    await page.mouse.move(area.x + 0.4 * area.width, area.y + 0.5 * area.height);
    await page
      .locator('[data-plot="wear"] .hoverlayer .legend, [data-plot="wear"] .hoverlayer .hovertext')
      .first()
      .waitFor();
    await page.mouse.click(area.x + 0.4 * area.width, area.y + 0.5 * area.height);
    await page.waitForFunction(() => location.hash.includes("segment="));
    const clicked = await recordShown(page);
    const latest = await json(`assets/${asset}/wear`);
    assert.notEqual(clicked.id, latest.segment_id, "not the latest record");

    const restored = await open(new URL(page.url()).hash);
    await recordShown(restored.page);
    assert.equal(await selectedTime(restored.page), await selectedTime(page));
    await close(restored, `${name} restored`);
    await close(opened, name);
  },

  "records are selected by keyboard": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    await page.getByRole("button", { name: "Previous" }).focus();
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => location.hash.includes("segment="));
    const first = await recordShown(page);
    await page.keyboard.press("Enter");
    await page.waitForFunction((id) => !location.hash.includes(id), first.id);
    const second = await recordShown(page);
    assert.ok(Date.parse(second.start_time) < Date.parse(first.start_time));
    await page.goBack();
    await recordShown(page);
    assert.equal(parameters(page).get("segment"), first.id);
    await close(opened, name);
  },

  "every view of a record is drawn and restored by the link": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    for (const label of ["Waveform", "Average over one turn", "Cepstrum"])
      await page.getByRole("button", { name: label, exact: true }).click();
    for (const kind of ["waveform", "turn", "cepstrum"]) await drawn(page, kind);
    const restored = await open(new URL(page.url()).hash);
    for (const kind of ["waveform", "turn", "cepstrum", "spectrum"]) await drawn(restored.page, kind);
    await close(restored, `${name} restored`);
    await close(opened, name);
  },

  "a waveform is zoomed down to its samples": async (name) => {
    const opened = await open(`#/assets/${asset}?show=waveform&part=0.1~0.11`);
    const { page } = opened;
    await drawn(page, "waveform");
    await page.locator('[data-plot="waveform"] .plot-sub', { hasText: "every sample" }).waitFor();
    const { sample_rate_hz: rate } = await json(
      `segments/${(await json(`assets/${asset}/wear`)).segment_id}`,
    );
    const points = await page.evaluate(
      () => document.querySelector('[data-plot="waveform"] .plot').data[0].x.length,
    );
    assert.ok(Math.abs(points - 0.01 * rate) <= 2, `${points} samples in 10 ms at ${rate} Hz`);
    await close(opened, name);
  },

  "a harmonic cursor is dragged onto a line and shows count and spacing": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    await page.getByLabel("Cursor", { exact: true }).selectOption("h");
    await readout(page).waitFor();
    const { mesh_frequency_hz: mesh } = (await json(`assets/${asset}/wear`)).shaft_speed;
    assert.ok((await readout(page).textContent()).includes("24 × shaft"), await readout(page).textContent());
    const handle = page.getByRole("slider", { name: "Fundamental of the harmonic cursor" });
    await handle.scrollIntoViewIfNeeded();
    const box = await handle.boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    const reach = await page.evaluate((hertz) => {
      const { xaxis } = document.querySelector('[data-plot="spectrum"] .plot')._fullLayout;
      return xaxis.l2p(2 * hertz) - xaxis.l2p(hertz);
    }, mesh);
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + reach, y, { steps: 6 });
    await page.mouse.up();
    // released near the second mesh harmonic, it snaps to that line's peak
    await page.waitForFunction(
      (hertz) => Math.abs(Number(/cursor=h(?:%7E|~)([\d.]+)/.exec(location.hash)?.[1]) / hertz - 2) < 0.02,
      mesh,
    );
    await handle.focus();
    const before = parameters(page).get("cursor");
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction(
      (was) => new URLSearchParams(location.hash.split("?")[1]).get("cursor") !== was,
      before,
    );
    await page.getByLabel("Cursor", { exact: true }).selectOption("s");
    await readout(page).getByText("Sidebands: centre").waitFor();
    const spacing = page.getByRole("slider", { name: "First upper sideband" });
    assert.ok(await spacing.isVisible());
    await close(opened, name);
  },

  "the mesh line is at the order of the tooth number": async (name) => {
    const opened = await open(`#/assets/${asset}?axis=orders`);
    const { page } = opened;
    await drawn(page, "spectrum");
    await page
      .locator('[data-plot="spectrum"] .infolayer', { hasText: "Order of the driving shaft" })
      .first()
      .waitFor();
    const { gear } = await json(`assets/${asset}`);
    const first = await page.evaluate(
      () => document.querySelector('[data-plot="spectrum"] .plot').data.at(-1).x[0],
    );
    assert.equal(first, gear.teeth[0]);
    await close(opened, name);
  },

  "a pinned record is drawn with the selected one": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    await page.getByRole("button", { name: "Pin to compare" }).click();
    await page.waitForFunction(() => location.hash.includes("pin="));
    await page.getByRole("button", { name: "Previous" }).click();
    await recordShown(page);
    await page.locator('[data-plot="spectrum"] .legend', { hasText: "pinned record" }).waitFor();
    assert.ok((await page.locator(".record-bar .fact .pinned-value").count()) >= 4);
    await close(opened, name);
  },

  "two records are compared in every view and restored by the link": async (name) => {
    const { items } = await json(`assets/${asset}/segments?limit=100`);
    const [first, last] = [items[2].id, items.at(-2).id];
    const [{ start_time: pinnedAt }, { start_time: selectedAt }] = [
      await json(`segments/${first}`),
      await json(`segments/${last}`),
    ];
    const opened = await open(
      `#/assets/${asset}?segment=${last}&pin=${first}&show=waveform,spectrum,envelope,turn,cepstrum`,
    );
    const { page } = opened;
    const read = {
      waveform: async (id) => (await json(`segments/${id}/waveform?max_points=4000`)).value,
      spectrum: async (id) => (await json(`segments/${id}/spectrum?max_points=4000`)).amplitude,
      envelope: async (id) => (await json(`segments/${id}/envelope?max_points=4000`)).amplitude,
      turn: async (id) => (await json(`segments/${id}/turn`)).average,
      cepstrum: async (id) => (await json(`segments/${id}/cepstrum?max_points=4000&max_s=0.2`)).value,
    };
    for (const [kind, values] of Object.entries(read)) {
      await drawn(page, kind);
      const curves = await page.evaluate(
        (key) => document.querySelector(`[data-plot="${key}"] .plot`).data.map(({ y }) => Array.from(y)),
        kind,
      );
      for (const id of [first, last]) {
        const wanted = await values(id);
        assert.ok(
          curves.some((curve) => curve.length === wanted.length && curve.every((y, n) => y === wanted[n])),
          `${kind} draws ${id === first ? "the pinned" : "the selected"} record as the server has it`,
        );
      }
      for (const words of [`selected, ${shownTime(selectedAt)}`, `pinned, ${shownTime(pinnedAt)}`])
        await page.locator(`[data-plot="${kind}"] .annotation-text`, { hasText: words }).waitFor();
      const scales = await page.evaluate(
        (key) =>
          [1, ""].map((n) =>
            document
              .querySelector(`[data-plot="${key}"] .plot`)
              ._fullLayout[n ? "yaxis2" : "yaxis"].range.map(Number),
          ),
        kind,
      );
      assert.deepEqual(scales[0], scales[1], `${kind} has both on the same scale`);
    }
    await page.locator(".record-bar", { hasText: `Pinned: ${shownTime(pinnedAt)}` }).waitFor();
    await page.getByRole("button", { name: "Unpin" }).click();
    await page
      .locator('[data-plot="spectrum"] .legend', { hasText: "pinned record" })
      .waitFor({ state: "detached" });
    assert.equal(parameters(page).get("pin"), null);
    await close(opened, name);
  },

  "a zoom is kept while new data comes in": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    const y = area.y + 0.5 * area.height;
    await page.mouse.move(area.x + 0.4 * area.width, y);
    await page.mouse.down();
    await page.mouse.move(area.x + 0.7 * area.width, y, { steps: 5 });
    await page.mouse.up();
    const range = (kind) =>
      page.evaluate(
        (k) => document.querySelector(`[data-plot="${k}"] .plot`).layout.xaxis.range.map(String),
        kind,
      );
    await page.waitForFunction(
      () => document.querySelector('[data-plot="wear"] .plot').layout.xaxis.autorange !== true,
    );
    const zoomed = await range("wear");
    await page.waitForTimeout(4500);
    // the address has whole seconds
    const apart = (ends) =>
      Math.max(...ends.map((end, n) => Math.abs(Date.parse(end) - Date.parse(zoomed[n]))));
    assert.ok(apart(await range("wear")) <= 1000, `${await range("wear")}, not ${zoomed}`);
    assert.ok(apart(await range("trends")) <= 1000, "the trends show the same stretch of time");
    await close(opened, name);
  },

  "numbers are saved as CSV and drawings as PNG": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    const save = async (button) => {
      const [download] = await Promise.all([
        page.waitForEvent("download"),
        page.getByRole("button", { name: button, exact: true }).click(),
      ]);
      const chunks = [];
      for await (const chunk of await download.createReadStream()) chunks.push(chunk);
      return Buffer.concat(chunks);
    };
    const csv = (await save("Spectrum: save as CSV")).toString();
    assert.match(csv, /^(# .*\r\n)+frequency_hz,amplitude_peak \(.*\)\r\n\d/);
    assert.ok(csv.split("\r\n").length > 100);
    assert.equal((await save("Spectrum: save as PNG")).subarray(1, 4).toString(), "PNG");
    await close(opened, name);
  },
};
