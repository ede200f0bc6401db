// A machine without gears: its page has what applies to it, and nothing of wear.

import assert from "node:assert/strict";
import {
  base,
  close,
  createAsset,
  drawn,
  noSidewaysScrolling,
  open,
  PHONE,
  removeAsset,
  sendNoise,
} from "./page.mjs";

const BEARING = {
  name: "drive_end_of_the_exhaust_fan",
  rolling_elements: 9,
  roller_diameter_mm: 7.94,
  pitch_diameter_mm: 39.04,
};

async function fan() {
  const id = `fan-${Date.now()}`;
  const body = {
    id,
    shaft: { speed_hz: 24.6 },
    bearings: [BEARING],
    velocity_zones: { machine_class: "group_2_rigid" },
  };
  const answer = await fetch(`${base}/v1/assets`, {
    method: "POST",
    headers: { "content-type": "application/json" },
    body: JSON.stringify(body),
  });
  assert.equal(answer.status, 201, await answer.text());
  for (const minute of [0, 1]) await sendNoise(id, minute);
  return id;
}

export const CHECKS = {
  "trends, spectra and alarms are shown, wear is not": async (name) => {
    const id = await fan();
    const opened = await open(`#/assets/${id}`);
    const { page } = opened;
    for (const kind of ["trends", "spectrum", "envelope"]) await drawn(page, kind);
    for (const kind of ["wear", "posterior"])
      assert.ok(await page.locator(`[data-plot="${kind}"]`).isHidden(), `no card for ${kind}`);
    for (const label of ["OMX", "FM4", "NA4", "Mesh harmonics", "Posterior over wear depth"])
      assert.equal(await page.getByRole("button", { name: label, exact: true }).count(), 0, label);
    const trends = await page.locator('[data-plot="trends"] .infolayer').first().textContent();
    assert.ok(trends.includes("Velocity (mm/s)"), trends);
    const words = await page.locator('[data-plot="spectrum"] .plot-sub').textContent();
    assert.ok(!words.includes("mesh"), words);
    const said = await page.locator(".sentence").textContent();
    assert.match(
      said,
      /^Collecting the baseline: 2 of 20 records. After that, deviating records are flagged.$/,
    );
    assert.equal(await page.getByRole("link", { name: "Wear preview" }).count(), 0);
    await close(opened, name);
    const preview = await open(`#/assets/${id}/wear`);
    await preview.page.getByText("This machine has no gear mesh").waitFor();
    await close(preview, `${name} preview`);
    await removeAsset(id);
  },

  "the cepstrum marks only the shaft's period": async (name) => {
    const id = await fan();
    const opened = await open(`#/assets/${id}?show=cepstrum`);
    const { page } = opened;
    await drawn(page, "cepstrum");
    const marked = await page.locator('[data-plot="cepstrum"] .annotation-text').allTextContents();
    assert.deepEqual(marked, ["shaft"]);
    await close(opened, name);
    await removeAsset(id);
  },

  "orders that a record does not have are explained, without a request": async (name) => {
    const machine = await fan();
    const gearbox = await createAsset("few-turns");
    await sendNoise(gearbox, 0);
    for (const [id, cause] of [
      [machine, "on a machine without gears the shaft's angle is known only from a tachometer"],
      [gearbox, "this record covers fewer than 4 whole turns of the shaft"],
    ]) {
      const opened = await open(`#/assets/${id}?axis=orders&show=spectrum,turn`);
      for (const [kind, what] of [
        ["spectrum", "No spectrum over orders"],
        ["turn", "No average over one turn"],
      ])
        await opened.page.locator(`[data-plot="${kind}"]`).getByText(`${what}: ${cause}`).waitFor();
      await close(opened, `${name} ${id.split("-")[0]}`);
      await removeAsset(id);
    }
  },

  "it fits a phone, with a long name of a bearing": async (name) => {
    const id = await fan();
    const opened = await open(`#/assets/${id}`, PHONE);
    await drawn(opened.page, "trends");
    await drawn(opened.page, "envelope");
    await noSidewaysScrolling(opened.page);
    await close(opened, name);
    await removeAsset(id);
  },
};
