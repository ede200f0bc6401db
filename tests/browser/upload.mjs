// Files uploaded from the page: WAV, CSV, dropped files, and rejected ones with a reason.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { asset, base, createAsset, json, open, removeAsset } from "./page.mjs";

const RATE = 4000;
const value = (n) => Math.sin((2 * Math.PI * 310 * n) / RATE) + 0.3 * Math.sin(n * n);

/** A gearbox of 24 and 26 teeth at 16.64 Hz, sampled at `rate`: mesh harmonics with sidebands, shaft lines, noise. */
export function gearbox(rate) {
  const lines = [1, 2, 3, 4].map((order) => [order, 0.3]);
  for (let order = 1; order <= 12; order++) {
    lines.push([24 * order, 1]);
    if (order <= 4) for (const side of [-2, -1, 1, 2]) lines.push([24 * order + side, 0.3]);
  }
  return (n) => {
    const turns = (16.64 * n) / rate;
    const sum = lines.reduce(
      (all, [order, amplitude]) => all + amplitude * Math.sin(2 * Math.PI * order * turns + order * order),
      0,
    );
    return 0.05 * (sum + Math.sin(n * n * 1.7));
  };
}

/** A WAV file of 16-bit samples. */
export function wav(samples, of = value, rate = RATE) {
  const bytes = Buffer.alloc(44 + 2 * samples);
  bytes.write("RIFF", 0);
  bytes.writeUInt32LE(36 + 2 * samples, 4);
  bytes.write("WAVEfmt ", 8);
  [
    [16, 16, 4],
    [20, 1, 2],
    [22, 1, 2],
    [24, rate, 4],
    [28, 2 * rate, 4],
    [32, 2, 2],
    [34, 16, 2],
  ].forEach(([at, number, size]) => bytes.writeUIntLE(number, at, size));
  bytes.write("data", 36);
  bytes.writeUInt32LE(2 * samples, 40);
  for (let n = 0; n < samples; n++) bytes.writeInt16LE(Math.round(9000 * of(n)), 44 + 2 * n);
  return bytes;
}

export const csv = (rows, broken) =>
  [
    "time,a1",
    ...Array.from({ length: rows }, (_, n) => `${n / RATE},${n === broken ? "none" : value(n)}`),
  ].join("\n");

/** A page of a new asset with the dialog open. */
async function dialog() {
  const id = await createAsset("upload", {});
  const opened = await open(`#/assets/${id}`);
  await opened.page.getByRole("button", { name: "Add records…" }).first().click();
  return { id, ...opened };
}

/**
 * Drags files, given as contents by name, over an element and drops them there; returns whether the page
 * accepted them.
 */
export function drop(page, files, place = "main h1") {
  const contents = Object.entries(files).map(([name, content]) => [name, [...Buffer.from(content)]]);
  return page.evaluate(
    ([list, where]) => {
      const transfer = new DataTransfer();
      for (const [name, content] of list) transfer.items.add(new File([new Uint8Array(content)], name));
      const target = document.querySelector(where);
      const send = (kind) =>
        target.dispatchEvent(
          new DragEvent(kind, { bubbles: true, cancelable: true, dataTransfer: transfer }),
        );
      return !send("dragover") && !send("drop");
    },
    [contents, place],
  );
}

/** Selects files and uploads them. */
async function choose(page, files) {
  await page.setInputFiles("#upload-file", files);
  await send(page);
}

const send = (page) => page.getByRole("button", { name: /^Upload (file|\d+ files)$/ }).click();

async function end({ id, page }) {
  await page.context().close();
  await removeAsset(id);
}

export const CHECKS = {
  "a WAV file becomes a record": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await choose(page, { name: "bearing.wav", mimeType: "audio/wav", buffer: wav(2000) });
    await page.locator('.result[data-kind="good"]').getByText("bearing.wav").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    assert.deepEqual(opened.faults, []);
    await end(opened);
  },

  "a CSV file becomes a record at the rate of its time column": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await choose(page, { name: "samples.csv", mimeType: "text/csv", buffer: Buffer.from(csv(2000)) });
    await page.locator('.result[data-kind="good"]').getByText("samples.csv").waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual([items[0].samples, items[0].sample_rate_hz], [2000, RATE]);
    const wave = await json(`segments/${items[0].id}/waveform?max_points=4000`);
    assert.ok(
      wave.value.every((sample, n) => Math.abs(sample - value(n)) < 1e-6),
      "no sample is changed",
    );
    await end(opened);
  },

  "a time column in first place is never read as vibration": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const clock = (n) => new Date(Date.UTC(2026, 2, 5, 6, 7, 28) + n).toISOString();
    const german = (n) =>
      `05.03.2026 06:07:${String(8 + Math.floor(n / 1000)).padStart(2, "0")},${String(n % 1000).padStart(3, "0")}`;
    const columns = {
      "Zeit [s]": (n) => String(n / 1000).replace(".", ","),
      "Time - Voltage_1": (n) => n / 1000,
      "X (ms)": (n) => n,
      t: (n) => n / 1000,
      Zeitstempel: german,
      timestamp: clock,
      time_ns: (n) => `${Date.UTC(2026, 2, 5, 6, 7, 48) + n}000000`,
    };
    for (const [index, [heading, cell]] of Object.entries(columns).entries()) {
      const text = [
        `${heading};a1`,
        ...Array.from({ length: 2000 }, (_, n) => `${cell(n)};${String(value(n)).replace(".", ",")}`),
      ].join("\n");
      await choose(page, {
        name: `2026-03-0${index + 1}_08-00-00.csv`,
        mimeType: "text/csv",
        buffer: Buffer.from(text),
      });
      await page
        .locator('.result[data-kind="good"]')
        .getByText(`2026-03-0${index + 1}_08-00-00.csv`)
        .waitFor();
    }
    const { items } = await json(`assets/${id}/segments`);
    assert.equal(items.length, 7, "one channel of each file");
    for (const { channel, sample_rate_hz: rate, start_time: start } of items)
      assert.deepEqual([channel, rate], [items[0].channel, 1000], start);
    for (const second of ["08", "28", "48"])
      assert.ok(
        items.some(({ start_time: start }) => start === `2026-03-05T06:07:${second}Z`),
        "times of day say the start",
      );

    const refused = (text, words) =>
      choose(page, { name: "odd.csv", mimeType: "text/csv", buffer: Buffer.from(text) }).then(() =>
        page.locator('.result[data-kind="bad"]', { hasText: words }).waitFor(),
      );
    await refused("Zeit [s];a1\n0;1\n0,1;2\n0,2;3\n0,9;4\n1;5", "csv line 5: 0.7 s after the line above");
    await refused("n;a1\n1;0,1\n2;0,5\n3;0,2\n4;0,1", /column "n" rises by the same step from line to line/);
    await page.locator("summary", { hasText: "sampling rate" }).click();
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("900");
    await refused(
      "Zeit [s];a1\n0;1\n0,001;2\n0,002;3\n0,003;4",
      "the sampling rate is 900 Hz, expected 1000 Hz",
    );
    await end(opened);
  },

  "each file has its own start, which can be corrected before the upload": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const timed = csv(500)
      .split("\n")
      .map((line, n) =>
        n ? line.replace(/^[^,]*/, new Date(Date.UTC(2026, 1, 3, 4, 5, 6) + n - 1).toISOString()) : line,
      )
      .join("\n");
    await drop(
      page,
      {
        "pump_20260301_101112.wav": wav(500),
        "pump_2026-03-02T10-11-12.250.wav": wav(600),
        "inside.csv": timed,
        "undated.wav": wav(700),
      },
      ".drop",
    );
    const start = (name) => page.getByLabel(`Start of ${name}, UTC`);
    await start("undated.wav").waitFor();
    assert.equal(await start("pump_20260301_101112.wav").inputValue(), "2026-03-01T10:11:12");
    assert.equal(await start("pump_2026-03-02T10-11-12.250.wav").inputValue(), "2026-03-02T10:11:12.25");
    assert.equal(await start("inside.csv").inputValue(), "2026-02-03T04:05:06");
    await page
      .locator(".files li", { hasText: "undated.wav" })
      .getByText("modification time of the file")
      .waitFor();
    await start("undated.wav").fill("2026-03-04T01:02:03");
    await send(page);
    await page.locator('.result[data-kind="good"]', { hasText: "undated.wav" }).waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual(
      items.map(({ start_time: time }) => time),
      ["2026-02-03T04:05:06Z", "2026-03-01T10:11:12Z", "2026-03-02T10:11:12.25Z", "2026-03-04T01:02:03Z"],
    );
    await end(opened);
  },

  "an MCAP recording's records are counted, and damage is reported": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const recording = (name) => readFile(new URL(`../../fixtures/recordings/${name}.mcap`, import.meta.url));
    await choose(page, {
      name: "run.mcap",
      mimeType: "application/mcap",
      buffer: await recording("mcap-json"),
    });
    await page
      .locator('.result[data-kind="good"]')
      .getByText(/run\.mcap: [1-9]\d* records read, [1-9]\d* stored, 0 already stored, 0 refused/)
      .waitFor();
    assert.ok((await json(`assets/${id}`)).summary.segments > 0);
    await choose(page, {
      name: "torn.mcap",
      mimeType: "application/mcap",
      buffer: await recording("mcap-bad-chunk-crc"),
    });
    const torn = page.locator('.results .result[data-kind="part"]');
    await torn.getByText(/torn\.mcap: .* 1 refused/).waitFor();
    assert.match(await torn.innerText(), /Record 1: mcap: damaged at byte \d+: Chunk CRC failed/);
    await end(opened);
  },

  "files dropped anywhere on the page are accepted": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.getByRole("button", { name: "Close" }).click();
    await drop(page, { "dropped.wav": wav(1000) });
    await send(page);
    await page.locator('.result[data-kind="good"]').getByText("dropped.wav").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    await end(opened);
  },

  "valid, broken and unknown files dropped together are distinguished": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await page.getByRole("button", { name: "Close" }).click();
    await drop(page, {
      "samples.csv": csv(1500),
      "broken.wav": "RIFF, and then nothing of a recording",
      "torn.csv": csv(100, 41),
      "notes.txt": "words",
    });
    const unknown = page.locator(".files > li", { hasText: "notes.txt" });
    await unknown.getByText("Expected a file of .wav").waitFor();
    page.once("dialog", (dialog) => dialog.accept()); // the times are those of the files
    await page.getByRole("button", { name: "Upload 3 files" }).click();
    await page.getByText("3 files read: 1 record added, 2 files rejected").waitFor();
    assert.equal(await unknown.count(), 1, "an unsupported file is not sent and keeps its reason");
    await page.getByRole("button", { name: "Remove notes.txt" }).click();
    assert.equal(await unknown.count(), 0);
    await page
      .locator('.result[data-kind="good"]', { hasText: /samples\.csv: record of .*, channel .*, stored/ })
      .waitFor();
    await page.locator('.result[data-kind="bad"]', { hasText: "broken.wav was rejected" }).waitFor();
    await page
      .locator('.result[data-kind="bad"]', {
        hasText: /torn\.csv was rejected: csv line 43, column "a1": "none", expected a finite number/,
      })
      .waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    assert.ok(await page.locator("body:not(.dropping)").count(), "the mark of a drag is gone");
    await end(opened);
  },

  "files dropped into the dialog or on another page of the asset are accepted": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    await drop(page, { "in-dialog.wav": wav(1000) }, ".drop");
    await send(page);
    await page.locator('.result[data-kind="good"]').getByText("in-dialog.wav").waitFor();
    assert.ok(await page.locator("body:not(.dropping)").count(), "the mark of a drag is gone");
    await page.goto(`${base}/#/assets/${id}/settings`);
    await page.getByLabel("Name", { exact: true }).fill("typed and not saved");
    await drop(page, { "on-settings.wav": wav(1200) });
    await send(page);
    await page.locator('.result[data-kind="good"]').getByText("on-settings.wav").waitFor();
    await page.getByRole("button", { name: "Close" }).click();
    assert.equal(await page.getByLabel("Name", { exact: true }).inputValue(), "typed and not saved");
    assert.equal((await json(`assets/${id}`)).summary.segments, 2);
    await end(opened);
  },

  "a file dropped on the fleet does not navigate, and a hint is shown": async () => {
    const { page, faults } = await open("");
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    const address = page.url();
    assert.ok(await drop(page, { "lost.wav": wav(100) }), "the browser is kept from showing the file itself");
    await page
      .getByRole("dialog")
      .getByText("lost.wav cannot be imported here: records belong to an asset")
      .waitFor();
    await page.keyboard.press("Escape");
    await page.getByRole("dialog").waitFor({ state: "detached" });
    assert.equal(page.url(), address);
    assert.deepEqual(faults, []);
    await page.context().close();
  },

  "records queued for analysis are reported as waiting": async () => {
    const opened = await dialog();
    const { id, page } = opened;
    const queued = {
      state: "queued",
      id: "0".repeat(32),
      asset_id: id,
      channel: "a1",
      start_time: "2026-03-01T08:00:00Z",
      received_at: "2026-03-01T08:00:09Z",
      unit: "m/s2",
      operating_point: {},
    };
    let body = queued;
    await page.route("**/segments*", (route) =>
      route.request().method() === "POST"
        ? route.fulfill({ status: 202, contentType: "application/json", body: JSON.stringify(body) })
        : route.continue(),
    );
    const one = (name) => choose(page, { name, mimeType: "audio/wav", buffer: wav(100) });
    const good = (words) => page.locator('.result[data-kind="good"]', { hasText: words }).waitFor();
    await one("one.wav");
    await good(
      "one.wav: record of 2026-03-01 08:00:00 UTC, channel a1, accepted and queued for analysis; the page updates by itself.",
    );
    body = { segments: [queued, { ...queued, channel: "a2" }] };
    await one("two.wav");
    await good("two.wav: record of 2026-03-01 08:00:00 UTC, channel a2, accepted");
    body = {
      records: 4,
      stored: 0,
      queued: 3,
      repeated: 1,
      refused_count: 0,
      refused: [],
      segments: ["1", "2", "3"].map((digit) => digit.repeat(24)),
      wear: null,
    };
    await one("run.wav");
    await good("run.wav: 4 records read, 0 stored, 3 queued for analysis, 1 already stored, 0 refused.");
    assert.deepEqual(opened.faults, []);
    await end(opened);
  },

  "broken files are rejected with a reason": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await page.getByRole("button", { name: "Add records" }).click();
    const refused = async (name, content, words) => {
      await choose(page, { name, mimeType: "application/octet-stream", buffer: Buffer.from(content) });
      await page.locator('.result[data-kind="bad"]').getByText(words).first().waitFor();
    };
    await page.setInputFiles("#upload-file", {
      name: "notes.txt",
      mimeType: "text/plain",
      buffer: Buffer.from("words"),
    });
    await page.getByText("Expected a file of .wav, .flac, .csv").waitFor();
    assert.ok(await page.getByRole("button", { name: /^Upload/ }).isHidden(), "there is nothing to upload");
    await page.getByRole("button", { name: "Remove notes.txt" }).click();
    await refused("broken.wav", "not a recording", "broken.wav was rejected");
    await refused("broken.csv", csv(100, 41), 'line 43, column "a1": "none", expected a finite number');
    await refused("untimed.csv", "a1\n1\n2\n3", "the sampling rate is missing");
    await page.context().close();
  },
};
