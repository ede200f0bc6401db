// The import page: names and units of channels of MCAP and MATLAB files, unknown units, truncated files, and
// the way on after an import.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { close, createAsset, json, open, removeAsset } from "./page.mjs";
import { wav } from "./upload.mjs";

const G = 9.80665;
const fixture = (path) => readFile(new URL(`../../fixtures/${path}`, import.meta.url));
const card = (page, name) => page.locator(".files > li", { hasText: name });
const send = (page) => page.getByRole("button", { name: /^Upload (file|\d+ files)$/ }).click();

async function desk(more = {}) {
  const id = await createAsset("channels", more);
  return { id, ...(await open(`#/assets/${id}/import`)) };
}

async function end(opened, name) {
  await close(opened, name);
  await removeAsset(opened.id);
}

const stored = async (id) => {
  const { items } = await json(`assets/${id}/segments`);
  return Object.fromEntries(items.map(({ channel, unit, indicators }) => [channel, [unit, indicators.rms]]));
};

export const CHECKS = {
  "channels of MCAP files get other names, and units where they have none": async (name) => {
    const opened = await desk({ sensor: {} });
    const { id, page } = opened;
    const file = async (path) => ({
      name: path,
      mimeType: "application/octet-stream",
      buffer: await fixture(`recordings/${path}`),
    });
    await page.setInputFiles("#upload-file", [
      await file("mcap-unchunked.mcap"),
      await file("mcap-json.mcap"),
    ]);
    const own = page.getByLabel("Unit of gearbox/x of mcap-json.mcap");
    await own.waitFor();
    assert.equal(await own.inputValue(), "g");
    assert.ok(await own.isDisabled(), "the file's own unit takes precedence");
    await page.getByLabel("Unit of x of mcap-unchunked.mcap").fill("mg");
    await page.getByLabel("Name of x of mcap-unchunked.mcap").fill("input");
    await page.getByLabel("Name of gearbox/x of mcap-json.mcap").fill("output");
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 2 records…" }).waitFor();
    const records = await stored(id);
    assert.deepEqual(
      Object.entries(records)
        .map(([channel, [unit]]) => [channel, unit])
        .sort(),
      [
        ["input", "mg"],
        ["output", "g"],
      ],
    );
    // the asset's page leads on from here
    await page.getByRole("link", { name: "Show the results" }).click();
    await page.waitForFunction((asset) => location.hash === `#/assets/${asset}`, id);
    await end(opened, name);
  },

  "each channel of a MATLAB file has its own unit and keeps its name": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    const buffer = await fixture("matlab/bearing-two-channels.mat");
    const title = "m_20260401_080000.mat";
    await page.locator("summary", { hasText: "sampling rate" }).click();
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("12000");
    await page.setInputFiles("#upload-file", [{ name: title, mimeType: "application/octet-stream", buffer }]);
    await page.getByLabel(`Unit of X097_FE_time of ${title}`).fill("g");
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 2 records…" }).waitFor();
    const records = await stored(id);
    assert.deepEqual(Object.keys(records).sort(), ["X097_DE_time", "X097_FE_time"]);
    // the same file with all samples in m/s², the asset's unit
    const plain = await desk();
    const parameters = "start_time=2026-04-01T08:00:00Z&sample_rate_hz=12000";
    const { href } = new URL(`/v1/assets/${plain.id}/segments?${parameters}`, page.url());
    await fetch(href, {
      method: "POST",
      headers: { "content-type": "application/x-matlab-data" },
      body: buffer,
    });
    const unscaled = await stored(plain.id);
    const ratio = (channel) => records[channel][1] / unscaled[channel][1];
    assert.ok(Math.abs(ratio("X097_DE_time") - 1) < 1e-6 && Math.abs(ratio("X097_FE_time") / G - 1) < 1e-4);
    await end(plain, `${name} in one unit`);
    await end(opened, name);
  },

  "a field keeps its focus while the file is inspected again": async (name) => {
    const opened = await desk();
    const { page } = opened;
    const title = "m_20260401_080000.mat";
    const buffer = await fixture("matlab/bearing-two-channels.mat");
    const inspected = () => page.waitForResponse("**/recording-preview*");
    await page.locator("summary", { hasText: "sampling rate" }).click();
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("12000");
    await page.setInputFiles("#upload-file", [{ name: title, mimeType: "application/octet-stream", buffer }]);
    const unit = page.getByLabel(`Unit of X097_FE_time of ${title}`);
    await unit.waitFor();
    // leaving the field of the rate has the file inspected again
    await Promise.all([inspected(), unit.focus()]);
    await page.waitForTimeout(200); // for the drawing after the answer
    await page.keyboard.type("g");
    assert.equal(await unit.inputValue(), "g");
    await end(opened, name);
  },

  "an unknown unit is pointed out, and so is a truncated WAV file": async (name) => {
    const opened = await desk({ sensor: {} });
    const { page } = opened;
    const whole = wav(2000);
    await page.setInputFiles("#upload-file", [
      { name: "torn.wav", mimeType: "audio/wav", buffer: whole.subarray(0, whole.length - 1500) },
    ]);
    await card(page, "torn.wav")
      .getByText(/It is truncated: [\d.]+ KiB of the [\d.]+ KiB of samples/)
      .waitFor();
    const unit = page.getByLabel("Unit", { exact: true });
    await unit.fill("furlong");
    await unit.blur();
    const words = page.getByText("“furlong” is stored as it is, but not converted");
    await words.waitFor();
    await unit.fill("mm/s");
    await unit.blur();
    await words.waitFor({ state: "hidden" });
    await end(opened, name);
  },

  "leaving the page during an upload has to be confirmed": async (name) => {
    const opened = await desk();
    const { page } = opened;
    let release;
    const held = new Promise((resolve) => (release = resolve));
    await page.route("**/segments?start_time=*", async (route) => {
      if (route.request().method() === "POST") await held;
      await route.continue();
    });
    await page.setInputFiles("#upload-file", [
      { name: "a_20260401_080000.wav", mimeType: "audio/wav", buffer: wav(2000) },
    ]);
    const prevented = () =>
      page.evaluate(() => !dispatchEvent(new Event("beforeunload", { cancelable: true })));
    assert.equal(await prevented(), false, "nothing is uploaded yet");
    await send(page);
    await page.getByRole("progressbar").waitFor();
    assert.equal(await prevented(), true);
    release();
    await page.getByRole("link", { name: "Show the results" }).waitFor();
    assert.equal(await prevented(), false, "the upload has ended");
    await end(opened, name);
  },
};
