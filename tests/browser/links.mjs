// Links reproduce the view: every control is restored from the address.

import assert from "node:assert/strict";
import { isDeepStrictEqual } from "node:util";
import {
  asset,
  close,
  createAsset,
  drawn,
  json,
  open,
  overviewDrawn,
  parameters,
  removeAsset,
  sendNoise,
} from "./page.mjs";

/** The values of all controls of a page by name, without parts that change between updates. */
const controls = (page) =>
  page.evaluate(() =>
    Object.fromEntries(
      [...document.querySelectorAll("main :is(select, input, [aria-pressed], [aria-sort], [aria-expanded])")]
        .filter((element) => element.checkVisibility() && element.type !== "file")
        .map((element) => {
          const name = element.id || (element.getAttribute("aria-label") ?? element.textContent).trim();
          const { type, checked, value, ariaPressed, ariaSort, ariaExpanded } = element;
          return [
            name,
            ariaPressed ?? ariaSort ?? ariaExpanded ?? (type === "checkbox" ? String(checked) : value),
          ];
        }),
    ),
  );

/** Sets controls one after the other, then compares them with those of the page that the link opens. */
async function linked(name, address, ready, steps, expected) {
  const opened = await open(address);
  const { page } = opened;
  await ready(page);
  const before = await controls(page);
  for (const step of steps) await step(page);
  await page.waitForTimeout(700);
  for (const parameter of expected)
    await page.waitForFunction((key) => new URLSearchParams(location.hash.split("?")[1]).has(key), parameter);
  assert.notDeepEqual(await controls(page), before, "something was set");
  const restored = await open(new URL(page.url()).hash);
  await ready(restored.page);
  // parts that depend on a record appear with it, on either page
  const alike = async () => isDeepStrictEqual(await controls(restored.page), await controls(page));
  for (let looks = 0; looks < 400 && !(await alike()); looks++) await restored.page.waitForTimeout(250);
  assert.deepEqual(await controls(restored.page), await controls(page));
  assert.deepEqual([...parameters(restored.page)], [...parameters(page)], "the link stays as it was");
  await close(restored, `${name} restored`);
  await close(opened, name);
}

const press = (name) => (page) => page.getByRole("button", { name, exact: true }).click();
const select = (id, value) => (page) => page.locator(`#${id}`).selectOption(value);
const check = (id) => (page) => page.locator(`#${id}`).check();

/** Drags across the middle of a plot to zoom in. */
const zoom = (kind) => async (page) => {
  const plot = page.locator(`[data-plot="${kind}"] .nsewdrag`).first();
  await plot.scrollIntoViewIfNeeded();
  const { x, y, width, height } = await plot.boundingBox();
  await page.mouse.move(x + 0.3 * width, y + 0.5 * height);
  await page.mouse.down();
  await page.mouse.move(x + 0.6 * width, y + 0.5 * height, { steps: 5 });
  await page.mouse.up();
};

const range = (page, kind) =>
  page.evaluate((key) => {
    const { xaxis } = document.querySelector(`[data-plot="${key}"] .plot`)._fullLayout;
    return xaxis.range.map((end) => xaxis.r2l(end));
  }, kind);

const near = ([a, b], [c, d], slack) => Math.abs(a - c) <= slack && Math.abs(b - d) <= slack;

export const CHECKS = {
  "a link to the fleet has filter, state and order": async (name) => {
    const row = (page) => page.locator("tbody tr[data-asset]").first().waitFor();
    const state = async (page) => page.locator(".fleet-tools .chip").first().click();
    const order = (page) => page.locator("thead button", { hasText: "Records" }).click();
    const search = (page) => page.getByPlaceholder("Name, id or location").fill("gear");
    await linked(name, "", row, [order, order, search, state], ["q", "sort", "desc", "state"]);
  },

  "a link to an asset has trends, axis, zoom, cursor, scales and views": async (name) => {
    const steps = [
      press("Kurtosis"),
      press("NA4"),
      check("trend-log"),
      select("trend-bins", "speed"),
      press("Cepstrum"),
      press("Average over one turn"),
      select("spectrum-axis", "orders"),
      select("spectrum-zoom", "2"),
      select("spectrum-cursor", "s"),
      check("spectrum-log"),
      check("sidebands"),
      select("envelope-range", "1"),
      press("Pin to compare"),
      press("◀ Previous"),
    ];
    await linked(name, `#/assets/${asset}`, overviewDrawn, steps, [
      "trend",
      "log",
      "bins",
      "show",
      "axis",
      "zoom",
      "cursor",
      "slog",
      "side",
      "near",
      "pin",
      "segment",
    ]);
  },

  "a link to one channel among several shows that channel": async (name) => {
    const id = await createAsset("channels", {});
    for (let minute = 0; minute < 3; minute++)
      for (const channel of ["a1", "a2"]) await sendNoise(id, minute, 1, channel);
    await linked(
      name,
      `#/assets/${id}?trend=rms`,
      (page) => drawn(page, "trends"),
      [select("channel", "a2")],
      ["channel"],
    );
    await removeAsset(id);
  },

  "a link to a waterfall has axis, end and range": async (name) => {
    const max = async (page) => {
      await page.locator("#waterfall-max").fill("60");
      await page.locator("#waterfall-max").press("Enter");
    };
    await linked(
      name,
      `#/assets/${asset}/waterfall`,
      (page) => drawn(page, "waterfall"),
      [
        select("waterfall-axis", "orders"),
        max,
        select("waterfall-floor", "40"),
        select("waterfall-cursor", "h"),
      ],
      ["axis", "max", "floor", "cursor"],
    );
  },

  "a link to a library has state and indicator": async (name) => {
    const { items } = await json("libraries");
    await linked(
      name,
      `#/libraries/${items[0].id}`,
      (page) => drawn(page, "grid"),
      [select("library-indicator", "omx"), press("Show state 2")],
      ["indicator", "state"],
    );
  },

  "a link has the zoomed time range and part of the spectrum": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    await zoom("wear")(page);
    await page.waitForFunction(() => location.hash.includes("time="));
    await zoom("spectrum")(page);
    await page.waitForFunction(() => location.hash.includes("band="));
    const [time, band] = [await range(page, "wear"), await range(page, "spectrum")];
    const restored = await open(new URL(page.url()).hash);
    await overviewDrawn(restored.page);
    for (const kind of ["wear", "trends"])
      assert.ok(near(await range(restored.page, kind), time, 2000), `${kind} shows the stretch of time`);
    assert.ok(
      near(await range(restored.page, "spectrum"), band, 0.01 * (band[1] - band[0])),
      "the spectrum shows its part",
    );
    // a double click resets the zoom and removes the range from the address
    for (const [kind, parameter] of [
      ["wear", "time"],
      ["spectrum", "band"],
    ]) {
      const area = restored.page.locator(`[data-plot="${kind}"] .nsewdrag`).first();
      await area.scrollIntoViewIfNeeded();
      // on a busy machine the two clicks may be too far apart for a double click
      for (let tries = 0; tries < 30 && parameters(restored.page).has(parameter); tries++) {
        await area.dblclick();
        await restored.page.waitForTimeout(1000);
      }
      assert.equal(parameters(restored.page).get(parameter), null);
    }
    await close(restored, `${name} restored`);
    await close(opened, name);
  },
};
