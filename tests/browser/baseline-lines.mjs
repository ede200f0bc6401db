// The change of spectral lines since the baseline, in the tables of the bench and of the envelope.

import assert from "node:assert/strict";
import { asset, close, drawn, json, open } from "./page.mjs";

const headings = (table) => table.locator("thead th").allTextContents();
const rowsOf = (table) =>
  table
    .locator("tbody tr")
    .evaluateAll((list) => list.map((row) => [...row.children].map((cell) => cell.textContent)));
const level = (text) => Number(text.replace("−", "-"));

/** The column of a table with this heading, once the server has answered for all its rows. */
async function column(table, heading) {
  await table.locator("thead").getByText(heading, { exact: true }).waitFor();
  await table.locator("tbody td", { hasText: /^…$/ }).first().waitFor({ state: "detached" });
  const place = (await headings(table)).indexOf(heading);
  return (await rowsOf(table)).map((cells) => cells[place]);
}

async function worn() {
  const { items } = await json(`assets/${asset}/segments?limit=1000&order=asc`);
  return [items.at(-1), items[Math.floor(items.length / 2)]];
}

/** Compares readings in dB with those of the service at the same places. */
async function agree(readings, id, places, query) {
  const { items } = await json(`segments/${id}/lines?${query}at=${places.join(",")}`);
  for (const [n, { change_db: expected }] of items.entries())
    assert.ok(
      Math.abs(level(readings[n]) - expected) < 0.11,
      `${places[n]}: ${readings[n]}, expected ${expected} dB`,
    );
}

export const CHECKS = {
  "the largest lines of each record have their change since the baseline": async (name) => {
    const chosen = await worn();
    const ids = chosen.map(({ id }) => id);
    for (const [axis, place] of [
      ["", "Frequency, Hz"],
      ["orders", "Order"],
    ]) {
      const opened = await open(`#/bench?records=${ids.join(",")}&peaks=5&axis=${axis}`);
      const { page } = opened;
      await drawn(page, "spectrum");
      const table = page.locator(".peak-list table");
      const changes = await column(table, "dB to baseline");
      const places = await column(table, place);
      assert.equal(changes.length, 10);
      for (const [n, id] of ids.entries())
        await agree(
          changes.slice(5 * n, 5 * n + 5),
          id,
          places.slice(5 * n, 5 * n + 5),
          axis ? "axis=orders&" : "",
        );
      await close(opened, `${name} ${axis}`);
    }
  },

  "the lines of an envelope cursor have their change since the baseline": async (name) => {
    const [{ id }] = await worn();
    const { band_hz: band, shaft_speed_hz: shaft } = await json(`segments/${id}/envelope`);
    const envelope = `spectrum=envelope&band_low_hz=${band[0]}&band_high_hz=${band[1]}&`;
    for (const [axis, place, first] of [
      ["", "Frequency, Hz", shaft],
      ["orders", "Order", 1],
    ]) {
      const opened = await open(`#/bench?records=${id}&show=envelope&axis=${axis}&ecursor=h~${first}`);
      const { page } = opened;
      await drawn(page, "envelope");
      const table = page.locator('[data-plot="envelope"] details.lines table');
      const changes = await column(table, "dB to baseline");
      const places = await column(table, place);
      assert.ok(changes.length >= 5, `${changes}`);
      await agree(changes.slice(0, 5), id, places.slice(0, 5), `${axis ? "axis=orders&" : ""}${envelope}`);
      await close(opened, `${name} ${axis}`);
    }
  },
};
