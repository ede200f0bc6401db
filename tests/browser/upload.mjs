// Files from the page: a WAV, a CSV, dropped ones, and broken ones that are refused in words.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { asset, base, createAsset, json, open, removeAsset } from "./page.mjs";

const RATE = 4000;
const value = (n) => Math.sin((2 * Math.PI * 310 * n) / RATE) + 0.3 * Math.sin(n * n);

/** A WAV file of 16-bit samples. */
function wav(samples) {
  const bytes = Buffer.alloc(44 + 2 * samples);
  bytes.write("RIFF", 0);
  bytes.writeUInt32LE(36 + 2 * samples, 4);
  bytes.write("WAVEfmt ", 8);
  [[16, 16, 4], [20, 1, 2], [22, 1, 2], [24, RATE, 4], [28, 2 * RATE, 4], [32, 2, 2], [34, 16, 2]].forEach(([at, number, size]) => bytes.writeUIntLE(number, at, size));
  bytes.write("data", 36);
  bytes.writeUInt32LE(2 * samples, 40);
  for (let n = 0; n < samples; n++) bytes.writeInt16LE(Math.round(9000 * value(n)), 44 + 2 * n);
  return bytes;
}

const csv = (rows, broken) => ["time,a1", ...Array.from({ length: rows }, (_, n) => `${n / RATE},${n === broken ? "none" : value(n)}`)].join("\n");

/** A page of a new asset with its dialog open. */
async function dialog() {
  const id = await createAsset("upload", {});
  const opened = await open(`#/assets/${id}`);
  await opened.page.getByRole("button", { name: "Add records…" }).first().click();
  return { id, ...opened };
}

/** Drags files, contents by name, over a place of the page and drops them there; whether the page took them is answered. */
function drop(page, files, place = "main h1") {
  const contents = Object.entries(files).map(([name, content]) => [name, [...Buffer.from(content)]]);
  return page.evaluate(([list, where]) => {
    const transfer = new DataTransfer();
    for (const [name, content] of list) transfer.items.add(new File([new Uint8Array(content)], name));
    const target = document.querySelector(where);
    const send = (kind) => target.dispatchEvent(new DragEvent(kind, { bubbles: true, cancelable: true, dataTransfer: transfer }));
    return !send("dragover") && !send("drop");
  }, [contents, place]);
}

async function end({ id, page }) {
  await page.context().close();
  await removeAsset(id);
}

export const CHECKS = {
  "a WAV file becomes a record": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", { name: "bearing.wav", mimeType: "audio/wav", buffer: wav(2000) });
    await page.locator('.result[data-kind="good"]').getByText("bearing.wav").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    assert.deepEqual(opened.faults, []);
    await end(opened);
  },

  "a CSV file becomes a record at the rate of its time column": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", { name: "samples.csv", mimeType: "text/csv", buffer: Buffer.from(csv(2000)) });
    await page.locator('.result[data-kind="good"]').getByText("samples.csv").waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual([items[0].samples, items[0].sample_rate_hz], [2000, RATE]);
    const wave = await json(`segments/${items[0].id}/waveform?max_points=4000`);
    assert.ok(wave.value.every((sample, n) => Math.abs(sample - value(n)) < 1e-6), "no sample is changed");
    await end(opened);
  },

  "an MCAP recording's records are counted, and damage is told": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const recording = (name) => readFile(new URL(`../../fixtures/recordings/${name}.mcap`, import.meta.url));
    await page.setInputFiles("#upload-file", { name: "run.mcap", mimeType: "application/mcap", buffer: await recording("mcap-json") });
    await page.locator('.result[data-kind="good"]').getByText(/run\.mcap: [1-9]\d* records read, [1-9]\d* stored, 0 already known, 0 refused/).waitFor();
    assert.ok((await json(`assets/${id}`)).summary.segments > 0);
    await page.setInputFiles("#upload-file", { name: "torn.mcap", mimeType: "application/mcap", buffer: await recording("mcap-bad-chunk-crc") });
    const torn = page.locator('.result[data-kind="part"]');
    await torn.getByText(/torn\.mcap: .* 1 refused/).waitFor();
    assert.match(await torn.innerText(), /Record 1: mcap: damaged at byte \d+: Chunk CRC failed/);
    await end(opened);
  },

  "files dropped anywhere on the page are taken": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.getByRole("button", { name: "Close" }).click();
    await drop(page, { "dropped.wav": wav(1000) });
    await page.locator('.result[data-kind="good"]').getByText("dropped.wav").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    await end(opened);
  },

  "a CSV file, a broken one and an unknown one dropped together are told apart": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.getByRole("button", { name: "Close" }).click();
    await drop(page, { "samples.csv": csv(1500), "broken.wav": "RIFF, and then nothing of a recording", "torn.csv": csv(100, 41), "notes.txt": "words" });
    await page.locator('.result[data-kind="good"]', { hasText: /samples\.csv: channel .* stored as the record of/ }).waitFor();
    await page.locator('.result[data-kind="bad"]', { hasText: "broken.wav was not taken" }).waitFor();
    await page.locator('.result[data-kind="bad"]', { hasText: "torn.csv was not taken: line 43, column “a1” is “none”, expected a finite number" }).waitFor();
    await page.locator('.result[data-kind="bad"]', { hasText: "notes.txt was not taken: expected a file that ends in .wav" }).waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    assert.ok(await page.locator("body:not(.dropping)").count(), "the mark of a drag is gone");
    await end(opened);
  },

  "files dropped into the dialog or on another page of the asset are taken there": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await drop(page, { "in-dialog.wav": wav(1000) }, ".drop");
    await page.locator('.result[data-kind="good"]').getByText("in-dialog.wav").waitFor();
    assert.ok(await page.locator("body:not(.dropping)").count(), "the mark of a drag is gone");
    await page.goto(`${base}/#/assets/${id}/settings`);
    await page.getByLabel("Name", { exact: true }).fill("typed and not saved");
    await drop(page, { "on-settings.wav": wav(1200) });
    await page.locator('.result[data-kind="good"]').getByText("on-settings.wav").waitFor();
    await page.getByRole("button", { name: "Close" }).click();
    assert.equal(await page.getByLabel("Name", { exact: true }).inputValue(), "typed and not saved");
    assert.equal((await json(`assets/${id}`)).summary.segments, 2);
    await end(opened);
  },

  "a file dropped on the fleet does not take the page away, and is told where it belongs": async () => {
    const { page, faults } = await open("");
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    const address = page.url();
    assert.ok(await drop(page, { "lost.wav": wav(100) }), "the browser is kept from showing the file itself");
    await page.getByRole("dialog").getByText("lost.wav cannot be taken here: records belong to an asset").waitFor();
    await page.keyboard.press("Escape");
    await page.getByRole("dialog").waitFor({ state: "detached" });
    assert.equal(page.url(), address);
    assert.deepEqual(faults, []);
    await page.context().close();
  },

  "records that others analyse later are told as waiting": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const queued = { state: "queued", id: "0".repeat(32), asset_id: id, channel: "a1", start_time: "2026-03-01T08:00:00Z", received_at: "2026-03-01T08:00:09Z", unit: "m/s2", operating_point: {} };
    let body = queued;
    await page.route("**/segments*", (route) => (route.request().method() === "POST" ? route.fulfill({ status: 202, contentType: "application/json", body: JSON.stringify(body) }) : route.continue()));
    const send = (name) => page.setInputFiles("#upload-file", { name, mimeType: "audio/wav", buffer: wav(100) });
    const good = (words) => page.locator('.result[data-kind="good"]', { hasText: words }).waitFor();
    await send("one.wav");
    await good("one.wav: channel a1 taken as the record of 2026-03-01 08:00:00 UTC; it waits to be analysed, and its wear shows up on the page by itself.");
    body = { segments: [queued, { ...queued, channel: "a2" }] };
    await send("two.wav");
    await good("two.wav: channel a2 taken as the record of 2026-03-01 08:00:00 UTC; it waits");
    body = { records: 4, stored: 0, queued: 3, repeated: 1, refused_count: 0, refused: [], wear: null };
    await send("run.wav");
    await good("run.wav: 4 records read, 0 stored, 3 taken and waiting to be analysed, 1 already known, 0 refused.");
    assert.deepEqual(opened.faults, []);
    await end(opened);
  },

  "broken files are refused in words": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await page.getByRole("button", { name: "Add records" }).click();
    const refused = async (name, content, words) => {
      await page.setInputFiles("#upload-file", { name, mimeType: "application/octet-stream", buffer: Buffer.from(content) });
      await page.locator('.result[data-kind="bad"]').getByText(words).first().waitFor();
    };
    await refused("broken.wav", "not a recording", "broken.wav was not taken");
    await refused("broken.csv", csv(100, 41), "line 43, column “a1” is “none”, expected a finite number");
    await refused("untimed.csv", "a1\n1\n2\n3", "the sampling rate is needed");
    await refused("notes.txt", "words", "expected a file that ends in .wav, .mcap, .csv");
    await page.context().close();
  },
};
