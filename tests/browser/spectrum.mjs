// The spectrum at full resolution: cursor readings, zooms, and the table of lines.

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
} from "./page.mjs";

const readout = (page) => page.locator(".cursor-readout");
const latest = async () => (await json(`assets/${asset}/wear`)).segment_id;
const whole = async (id, kind = "spectrum") => json(`segments/${id}/${kind}?max_points=200000`);

/** The maximum of the three lines nearest to a frequency, of a spectrum without gaps. */
function amplitudeAt({ resolution_hz: step, amplitude }, frequency) {
  const nearest = Math.round(frequency / step);
  return Math.max(...amplitude.slice(nearest - 1, nearest + 2));
}

const digits = (value) => Number(value.toPrecision(3)).toString();
const rows = (page) =>
  page
    .locator('[data-plot="spectrum"] .lines tbody tr')
    .evaluateAll((list) => list.map((row) => [...row.children].map((cell) => cell.textContent)));

/** Sends a record that is too long for its envelope spectrum to be drawn whole. */
async function sendLong(id) {
  const samples = Array.from(
    { length: 80_000 },
    (_, n) => (1 + 0.5 * Math.sin(n * 0.016)) * Math.sin(n * 1.3) + 0.2 * Math.sin(n * n),
  );
  await sendRecord(id, { samples });
}

export const CHECKS = {
  "a cursor reads every line of the spectrum": async (name) => {
    const opened = await open(`#/assets/${asset}?zoom=1&cursor=s~397.6~4`);
    const { page } = opened;
    const full = await whole(await latest());
    assert.ok(full.amplitude.length > 4000, "more lines than are drawn of the whole");
    const sides = [-5, -4, -3, -2, -1, 1, 2, 3, 4, 5].map((k) => amplitudeAt(full, 397.6 + 4 * k));
    await readout(page)
      .getByText(`root sum square ${digits(Math.hypot(...sides))} m/s²`)
      .waitFor();
    await readout(page)
      .getByText(`at ${digits(amplitudeAt(full, 397.6))} m/s²`)
      .waitFor();
    assert.equal((await rows(page)).length, 11);
    // a cursor across the whole spectrum
    await page.goto(`${page.url().split("?")[0]}?cursor=h~150`);
    const harmonics = Array.from({ length: 30 }, (_, n) => amplitudeAt(full, 150 * (n + 1)));
    const strongest = harmonics.indexOf(Math.max(...harmonics));
    await readout(page)
      .getByText(`strongest ${strongest + 1}× at ${digits(harmonics[strongest])} m/s²`)
      .waitFor();
    await close(opened, name);
  },

  "sidebands in the noise are marked, and left out of the sum": async (name) => {
    const id = await createAsset("noisy-sidebands");
    // a tone at 500 Hz with one sideband on either side, 20 Hz away, in noise
    let seed = 7;
    const uniform = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    const gauss = () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
    const tone = (hertz, n) => Math.sin((2 * Math.PI * hertz * n) / 4000);
    const samples = Array.from(
      { length: 8000 },
      (_, n) => tone(500, n) + 0.3 * (tone(480, n) + tone(520, n)) + 0.5 * gauss(),
    );
    await sendRecord(id, { samples });
    const opened = await open(`#/assets/${id}?cursor=s~500~20`);
    await readout(opened.page).getByText("2 of 10 lines above the noise, root sum square 0.4").waitFor();
    const table = await rows(opened.page);
    const bracketed = table.filter((cells) => cells.some((cell) => /^\([\d.]+\)$/.test(cell)));
    assert.deepEqual(
      bracketed.map(([label]) => label),
      ["−5", "−4", "−3", "−2", "+2", "+3", "+4", "+5"],
    );
    const marked = opened.page.locator(".lines .in-noise").first();
    assert.match(await marked.getAttribute("title"), /^in the noise: less than 2.5 times/);
    await opened.page.locator('[data-plot="spectrum"] .lines').getByText("(…) in the noise").waitFor();
    await close(opened, name);
    await removeAsset(id);
  },

  "a zoom draws every line of its part": async (name) => {
    const opened = await open(`#/assets/${asset}?band=1000~1200`);
    const { page } = opened;
    await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "all drawn" }).waitFor();
    await drawn(page, "spectrum");
    const [x, y] = await page.evaluate(() => {
      const [line] = document.querySelector('[data-plot="spectrum"] .plot').data;
      return [Array.from(line.x), Array.from(line.y)];
    });
    const full = await whole(await latest());
    const inside = (list) =>
      list.filter((_, n) => full.frequency_hz[n] >= 1000 && full.frequency_hz[n] <= 1200);
    const within = x.flatMap((hz, n) => (hz >= 1000 && hz <= 1200 ? [y[n]] : []));
    assert.deepEqual(within, inside(full.amplitude));
    await close(opened, name);
  },

  "a zoom over orders draws every line of its part": async (name) => {
    const opened = await open(`#/assets/${asset}?axis=orders&zoom=2`);
    const { page } = opened;
    await page.locator('[data-plot="spectrum"] .plot-sub', { hasText: "all drawn" }).waitFor();
    await drawn(page, "spectrum");
    const { order } = await whole(await latest(), "orders");
    const shown = await page.evaluate(() =>
      Array.from(document.querySelector('[data-plot="spectrum"] .plot').data[0].x),
    );
    const near = (list) => list.filter((value) => value > 44 && value < 52).length;
    assert.equal(near(shown), near(order));
    await close(opened, name);
  },

  "a zoom of the envelope draws every line of its part": async (name) => {
    const id = await createAsset("long", {});
    const opened = await open(`#/assets/${id}`);
    const { page } = opened;
    await sendLong(id);
    await drawn(page, "envelope");
    const words = page.locator('[data-plot="envelope"] .plot-sub');
    await words.getByText("reduced for display").waitFor();
    const plane = page.locator('[data-plot="envelope"] .nsewdrag').first();
    await plane.scrollIntoViewIfNeeded();
    const area = await plane.boundingBox();
    const [from, to] = [0.2, 0.3].map((share) => area.x + share * area.width);
    const middle = area.y + 0.5 * area.height;
    await page.mouse.move(from, middle);
    await page.mouse.down();
    await page.mouse.move(to, middle, { steps: 6 });
    await page.mouse.up();
    await page.waitForFunction(() => location.hash.includes("eband="));
    await words.getByText("all drawn").waitFor();
    const [low, high] = parameters(page).get("eband").split("~").map(Number);
    const full = await whole((await json(`assets/${id}/segments`)).items[0].id, "envelope");
    const inside = full.amplitude.filter(
      (_, n) => full.frequency_hz[n] >= low && full.frequency_hz[n] <= high,
    );
    const within = () =>
      page.evaluate(
        ([low, high]) => {
          const [{ x, y }] = document.querySelector('[data-plot="envelope"] .plot').data;
          return Array.from(y).filter((_, n) => x[n] >= low && x[n] <= high);
        },
        [low, high],
      );
    assert.deepEqual(await within(), inside);
    await page.reload();
    await drawn(page, "envelope"); // its words come first
    await words.getByText("all drawn").waitFor();
    assert.deepEqual(await within(), inside, "the link restores the zoom");
    await close(opened, name);
    await removeAsset(id);
  },

  "a table lists the mesh lines and their change since the baseline": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await drawn(page, "spectrum");
    const [{ mesh_harmonics: harmonics, shaft_speed_hz: shaft }, head] = [
      await whole(await latest()),
      page.locator('[data-plot="spectrum"] .lines thead'),
    ];
    await head.getByText("dB to baseline").waitFor();
    const table = await rows(page);
    assert.equal(table.length, harmonics.length);
    const [{ frequency_hz: hz, amplitude, baseline_amplitude: healthy }] = harmonics;
    const [label, order, frequency, height, grown] = table[0];
    assert.equal(label, "mesh 1×");
    assert.ok(
      Math.abs(order - hz / shaft) < 0.01 && Math.abs(frequency - hz) < 0.01,
      `${order}, ${frequency}`,
    );
    assert.ok(Math.abs(height / amplitude - 1) < 1e-3, height);
    assert.ok(Math.abs(Number(grown.replace("−", "-")) - 20 * Math.log10(amplitude / healthy)) < 0.06, grown);
    await close(opened, name);
  },

  "every line of the table has its change since the baseline": async (name) => {
    const id = await latest();
    const now = await whole(id);
    const { baseline } = await json(`assets/${asset}/wear`);
    const { items } = await json(`assets/${asset}/segments?limit=${Math.min(24, baseline.need)}`);
    const healthy = await Promise.all(items.map((record) => whole(record.id)));
    const { frequency_hz: mesh } = now.mesh_harmonics[0];
    // the same line of each record is at the same order
    const changeAt = (hz) => {
      const then = healthy.map((each) =>
        Math.log(amplitudeAt(each, (hz * each.shaft_speed_hz) / now.shaft_speed_hz)),
      );
      const mean = Math.exp(then.reduce((sum, each) => sum + each, 0) / then.length);
      return 20 * Math.log10(amplitudeAt(now, hz) / mean);
    };
    const shaft = Number(now.shaft_speed_hz.toPrecision(7));
    const centre = Number(mesh.toPrecision(7));
    const opened = await open(`#/assets/${asset}?zoom=1&cursor=s~${centre}~${shaft}`);
    const { page } = opened;
    const column = async () => (await rows(page)).map((row) => row.at(-1).replace("−", "-"));
    await page.locator('[data-plot="spectrum"] .lines thead').getByText("dB to baseline").waitFor();
    const settled = async () => (await column()).every((cell) => Number.isFinite(Number(cell)));
    for (let looks = 0; looks < 400 && !(await settled()); looks++) await page.waitForTimeout(250);
    const cells = await column();
    assert.equal(cells.length, 11);
    for (const [n, cell] of cells.entries()) {
      if (n === 5) continue; // the mesh line's own baseline value comes with the spectrum
      const wanted = changeAt(centre + (n - 5) * shaft);
      assert.ok(Math.abs(Number(cell) - wanted) < 0.1, `line ${n}: ${cell}, expected ${wanted}`);
    }
    // over orders too
    await page.goto(`${page.url().split("?")[0]}?axis=orders`);
    await page.locator('[data-plot="spectrum"] .lines thead th', { hasText: "Frequency" }).waitFor({
      state: "detached",
    });
    await page.locator('[data-plot="spectrum"] .lines thead').getByText("dB to baseline").waitFor();
    await close(opened, name);
  },

  "a sideband cursor starts in the visible part": async (name) => {
    for (const view of ["zoom=2", "band=3000~3300", ""]) {
      const opened = await open(`#/assets/${asset}?${view}`);
      const { page } = opened;
      await drawn(page, "spectrum");
      await page.getByLabel("Cursor", { exact: true }).selectOption("s");
      await readout(page).getByText("Sidebands: centre").waitFor();
      for (const slider of ["Centre of the sideband cursor", "First upper sideband of the cursor"])
        await page.getByRole("slider", { name: slider }).waitFor();
      await close(opened, `${name} ${view}`);
    }
  },

  "a cursor's lines are below the peaks that they measure": async (name) => {
    const opened = await open(`#/assets/${asset}?cursor=h~400`);
    const { page } = opened;
    await page.locator('[data-plot="spectrum"] .cursor-line').first().waitFor({ state: "attached" });
    const under = await page.evaluate(() => {
      const [lines, plot] = [".cursor-line", ".plot"].map((name) =>
        document.querySelector(`[data-plot="spectrum"] ${name}`),
      );
      return (
        Boolean(lines.compareDocumentPosition(plot) & Node.DOCUMENT_POSITION_FOLLOWING) &&
        getComputedStyle(plot).position === "relative"
      );
    });
    assert.ok(under);
    await close(opened, name);
  },
};
