// The import page: previews before the upload, rejected files that do not stop others, and undoing an import.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import {
  asset,
  base,
  close,
  counted,
  createAsset,
  json,
  noSidewaysScrolling,
  open,
  PHONE,
  removeAsset,
  sendNoise,
  shoot,
  shownTime,
} from "./page.mjs";
import { csv, drop, gearbox, wav } from "./upload.mjs";

const replays = process.env.FLANKWATCH_REPLAYS; // the service's replay folder
const audio = (name, buffer) => ({ name, mimeType: "audio/wav", buffer });
const table = (name, text) => ({ name, mimeType: "text/csv", buffer: Buffer.from(text) });
const card = (page, name) => page.locator(".files > li", { hasText: name });
const send = (page) => page.getByRole("button", { name: /^Upload (file|\d+ files)$/ }).click();
const good = (page, words) => page.locator('.result[data-kind="good"]', { hasText: words }).first().waitFor();

async function desk(more = {}) {
  const id = await createAsset("import", more);
  return { id, ...(await open(`#/assets/${id}/import`)) };
}

async function end(opened, name) {
  if (name) await close(opened, name);
  else await opened.page.context().close();
  assert.deepEqual(opened.faults, []);
  await removeAsset(opened.id);
}

/** A WAV file of 16-bit samples as one of 24 bits. */
function deep(file) {
  const frames = (file.length - 44) / 2;
  const bytes = Buffer.alloc(44 + 3 * frames);
  file.copy(bytes, 0, 0, 44);
  [
    [4, 36 + 3 * frames, 4],
    [28, 3 * file.readUInt32LE(24), 4],
    [32, 3, 2],
    [34, 24, 2],
    [40, 3 * frames, 4],
  ].forEach(([at, number, size]) => bytes.writeUIntLE(number, at, size));
  for (let n = 0; n < frames; n++) bytes.writeIntLE(256 * file.readInt16LE(44 + 2 * n), 44 + 3 * n, 3);
  return bytes;
}

/** A WAV file of 16-bit samples of two channels and a chunk before them. */
function stereo(frames) {
  const bytes = Buffer.alloc(64 + 4 * frames);
  bytes.write("RIFF", 0);
  bytes.writeUInt32LE(56 + 4 * frames, 4);
  bytes.write("WAVEfmt ", 8);
  [
    [16, 16, 4],
    [20, 1, 2],
    [22, 2, 2],
    [24, 8000, 4],
    [28, 32000, 4],
    [32, 4, 2],
    [34, 16, 2],
  ].forEach(([at, number, size]) => bytes.writeUIntLE(number, at, size));
  bytes.write("LIST", 36);
  bytes.writeUInt32LE(12, 40);
  bytes.write("data", 56);
  bytes.writeUInt32LE(4 * frames, 60);
  for (let n = 0; n < frames; n++) {
    bytes.writeInt16LE(Math.round(9000 * Math.sin(n * 0.3)), 64 + 4 * n);
    bytes.writeInt16LE(Math.round(3000 * Math.sin(n * 0.7)), 66 + 4 * n);
  }
  return bytes;
}

export const CHECKS = {
  "FLAC, NumPy and compressed CSV files are inspected and sent": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    const fixture = (path) => readFile(new URL(`../../fixtures/${path}`, import.meta.url));
    const type = "application/octet-stream";
    await page.setInputFiles("#upload-file", [
      { name: "mono.flac", mimeType: type, buffer: await fixture("flac/mono-16.flac") },
      { name: "array.npy", mimeType: type, buffer: await fixture("npy/int16-two-channels.npy") },
      { name: "table.csv.gz", mimeType: type, buffer: await fixture("csv/compressed.csv.gz") },
    ]);
    await card(page, "mono.flac").getByText("FLAC · 1 channel · 20 kHz (from the file) · 0.25 s").waitFor();
    await card(page, "array.npy").getByText("Sample rate is missing").waitFor();
    // the values for all files unfold by themselves, as the rate is missing
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("12800");
    await page.getByLabel("Unit", { exact: true }).fill("m/s2");
    await card(page, "array.npy").getByText("NumPy · 2 channels · 12.8 kHz (entered)").waitFor();
    await card(page, "table.csv").getByText("CSV · 1 channel · 12.8 kHz (entered)").waitFor();
    page.once("dialog", (dialog) => dialog.accept()); // the times are those of the files
    await page.getByRole("button", { name: "Upload 3 files" }).click();
    await page.getByRole("button", { name: "Undo this import: delete 4 records" }).waitFor();
    const stored = (await json(`assets/${id}/segments`)).items;
    assert.deepEqual(stored.map((segment) => segment.raw.media_type.split(";")[0]).sort(), [
      "application/x-npy",
      "application/x-npy",
      "audio/flac",
      "text/csv",
    ]);
    await end(opened, name);
  },

  "records of another gearbox ask whether teeth and speed are right": async (name) => {
    const opened = await desk({ gear: { teeth: [32, 80], shaft_speed_hz: 30 } });
    const { id, page } = opened;
    const question =
      /the lines fit 24 × 16.64 Hz better than 32 × .*; are the tooth counts and the speed correct\?/;
    const buffer = wav(20_000, gearbox(10_000), 10_000);
    await page.setInputFiles("#upload-file", [audio("pump_20260401_080000.wav", buffer)]);
    await send(page);
    const asked = page.locator('.import-desk > .result[data-kind="part"]', { hasText: question });
    await asked.getByText("The speed of the latest record is uncertain").waitFor();
    await shoot(page, name);
    await page.goto(`${base}/#/assets/${id}`);
    await page.locator(".sentence", { hasText: question }).waitFor();
    // a speed given with the record is used for the baseline, and asked about too
    await page.goto(`${base}/#/assets/${id}/import`);
    await page.locator("summary", { hasText: "sampling rate" }).click();
    await page.getByLabel("Shaft speed, rpm").fill("1800");
    await page.setInputFiles("#upload-file", [audio("pump_20260401_090000.wav", buffer)]);
    await send(page);
    await asked.waitFor();
    await page.goto(`${base}/#/assets/${id}`);
    await page.locator(".sentence", { hasText: /^Collecting the baseline: 1 of \d+ records/ }).waitFor();
    await page.locator(".sentence", { hasText: question }).waitFor();
    await end(opened);
  },

  "a preview shows the contents of each file before the upload": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    const recording = await readFile(new URL("../../fixtures/recordings/mcap-json.mcap", import.meta.url)); // of a recorder that wrote no summary
    const other = await createAsset("exported", {});
    await sendNoise(other, 7);
    const exported = Buffer.from(await (await fetch(`${base}/v1/assets/${other}/export`)).arrayBuffer());
    await removeAsset(other);
    const matlab = await readFile(new URL("../../fixtures/matlab/bearing-two-channels.mat", import.meta.url));
    const [record] = (await json(`assets/${asset}/segments?limit=1`)).items;
    const block = Buffer.from(await (await fetch(`${base}/v1/segments/${record.id}/raw`)).arrayBuffer());
    await page.setInputFiles("#upload-file", [
      { name: "two.mat", mimeType: "application/x-matlab-data", buffer: matlab },
      { name: "block.pb", mimeType: "application/x-protobuf", buffer: block },
      audio("pump_20260301_101112.wav", wav(4000)),
      audio("two.wav", stereo(8000)),
      table("samples.csv", csv(1000)),
      { name: "run.mcap", mimeType: "application/mcap", buffer: recording },
      { name: "export.mcap", mimeType: "application/mcap", buffer: exported },
      audio("broken.wav", Buffer.from("no recording")),
    ]);
    await page.getByRole("button", { name: "Upload 8 files" }).waitFor();
    await card(page, "pump_20260301").getByText("16 bit integers · 1 channel · 4000 Hz · 1 s").waitFor();
    await card(page, "pump_20260301").getByText("from the file name, read as UTC").waitFor();
    await card(page, "two.wav").getByText("16 bit integers · 2 channels · 8000 Hz · 1 s").waitFor();
    await counted(card(page, "two.wav").locator("svg.sketch"), 2); // a waveform of each channel
    await card(page, "samples.csv").getByText("CSV · 1 channel · 4000 Hz (column “time”) · 0.25 s").waitFor();
    await card(page, "run.mcap").getByText("no summary at the end of the file").waitFor();
    await card(page, "export.mcap")
      .getByText(/MCAP · \d+ messages on \d+ topics?/)
      .waitFor();
    await card(page, "export.mcap")
      .getByText(/start times in the file, logged 20/)
      .waitFor();
    await card(page, "run.mcap").locator("svg.sketch").first().waitFor();
    await card(page, "run.mcap").getByText("its first record").first().waitFor();
    await card(page, "export.mcap").getByText("No vibration found").waitFor();
    await card(page, "block.pb").getByText("protobuf · 1 channel · 20 kHz · 1 s").waitFor();
    await card(page, "block.pb")
      .getByText(`start times in the file: ${shownTime(record.start_time)}`)
      .waitFor();
    await card(page, "block.pb").locator("svg.sketch").waitFor();
    // a MATLAB file without a rate is inspected again when one is entered
    await card(page, "two.mat").locator('.result[data-kind="bad"]').waitFor();
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("12000");
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").blur();
    await card(page, "two.mat").getByText("MATLAB · 2 channels · 12 kHz (entered)").waitFor();
    await counted(card(page, "two.mat").locator("svg.sketch"), 2); // a waveform of each channel
    await card(page, "broken.wav").getByText("It does not start like a WAV file (RIFF, WAVE).").waitFor();
    await page.getByLabel("Start of two.wav, UTC").fill("2026-03-02T08:00:00");
    await page.getByLabel("Start of two.wav, UTC").blur();
    await card(page, "two.wav").getByText("entered").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 0, "nothing is sent");
    await end(opened, name);
  },

  "all files are uploaded, a rejected one does not stop the others, and the import is undone": async (
    name,
  ) => {
    const opened = await desk();
    const { id, page } = opened;
    await sendNoise(id, 0);
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("broken.wav", Buffer.from("no recording")),
      audio("b_20260401_090000.wav", wav(2100)),
      audio("two_20260401_100000.wav", stereo(2000)),
    ]);
    await send(page);
    await good(page, "a_20260401_080000.wav: record of");
    await page.locator('.result[data-kind="bad"]', { hasText: "broken.wav was rejected" }).waitFor();
    await good(page, "two_20260401_100000.wav: record of");
    const undo = page.getByRole("button", { name: "Undo this import: delete 4 records…" });
    await undo.waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 5);
    await shoot(page, `${name} sent`);
    page.on("dialog", (dialog) => dialog.accept());
    await undo.click();
    await page.getByText("4 records deleted. Import undone.").waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual(
      items.map(({ start_time: start }) => start),
      ["2026-03-01T08:00:00Z"],
      "what was there before stays",
    );
    assert.match(
      opened.faults.splice(0).join(),
      /^console: [^,]* 422 [^,]*$/,
      "but for the refused file nothing goes wrong",
    );
    await end(opened, name);
  },

  "each upload has its progress": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    // each upload waits until it is let go, which may be before its request arrives
    const [go, held] = [[], []];
    for (let n = 0; n < 2; n++) held.push(new Promise((resolve) => go.push(resolve)));
    await page.route(`**/assets/${id}/segments?*`, async (route) => {
      if (route.request().method() === "POST") await held.shift();
      await route.continue();
    });
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("b_20260401_090000.wav", wav(2100)),
    ]);
    await send(page);
    const results = page.locator(".results > .result");
    await results
      .nth(0)
      .getByText(
        /^(Uploading a_20260401_080000.wav, 3.9\d* KiB…|a_20260401_080000.wav: uploaded, analysing…)$/,
      )
      .waitFor();
    const bar = page.getByRole("progressbar", { name: "Upload of a_20260401_080000.wav" });
    await bar.waitFor();
    await results.nth(1).getByText("b_20260401_090000.wav: waiting.").waitFor();
    assert.ok(await page.getByRole("progressbar", { name: "Upload of b_20260401_090000.wav" }).isHidden());
    await shoot(page, `${name} first`);
    go[0]();
    await good(page, "a_20260401_080000.wav: record of");
    await bar.waitFor({ state: "detached" });
    await page.getByRole("progressbar", { name: "Upload of b_20260401_090000.wav" }).waitFor();
    go[1]();
    await good(page, "b_20260401_090000.wav: record of");
    await counted(page.locator(".results progress"), 0);
    await end(opened, name);
  },

  "a repeated upload says what was stored already, and asks about a start in the future": async (name) => {
    const opened = await desk();
    const { page } = opened;
    const [first, second] = [0, 1].map((n) => audio(`run_20260401_08000${n}.wav`, wav(2000)));
    await page.setInputFiles("#upload-file", [first]);
    await page.getByRole("button", { name: "Upload file" }).click();
    await page.getByText("channel 1, stored").waitFor();
    await page.setInputFiles("#upload-file", [first, second]);
    await page.getByRole("button", { name: "Upload 2 files" }).click();
    await page.getByText("channel 1, already stored, not added again.").waitFor();
    await page.getByText("2 files read: 1 record added, 1 already stored.").waitFor();
    await page.setInputFiles("#upload-file", [audio("run_20990401_080000.wav", wav(2000))]);
    const asked = page.waitForEvent("dialog");
    const click = page.getByRole("button", { name: "Upload file" }).click();
    const dialog = await asked;
    assert.match(dialog.message(), /starts in the future, at 2099-04-01 08:00:00 UTC/);
    await dialog.dismiss();
    await click;
    await end(opened, name);
  },

  "files of one import with the same start and channel are reported": async (name) => {
    const opened = await desk();
    const { page } = opened;
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("b_20260401_080000.wav", wav(2100)),
      audio("c_20260401_090000.wav", wav(2100)),
    ]);
    const twin = (file, words) =>
      card(page, file).getByText(`Same start and channel as ${words} in this import`);
    await twin("a_2026", "b_20260401_080000.wav").waitFor();
    await twin("b_2026", "a_20260401_080000.wav").waitFor();
    assert.equal(await twin("c_2026", "").count(), 0);
    await shoot(page, name);
    // another channel, then another start
    const channel = page.getByLabel("Name of 1 of b_20260401_080000.wav");
    await channel.fill("gear side");
    await channel.blur();
    await twin("a_2026", "b_20260401_080000.wav").waitFor({ state: "hidden" });
    const start = page.getByLabel("Start of c_20260401_090000.wav, UTC");
    await start.fill("2026-04-01T08:00:00");
    await start.blur();
    await twin("c_2026", "a_20260401_080000.wav").waitFor();
    await page.getByRole("button", { name: "Remove c_20260401_090000.wav" }).click();
    await twin("a_2026", "c_20260401_090000.wav").waitFor({ state: "hidden" });
    await end(opened);
  },

  ...(replays && {
    "the first records of an MCAP file are compared with those that exist": async (name) => {
      const { items } = await json(`assets/${asset}/segments?limit=1&order=asc`);
      const buffer = await readFile(join(replays, "shift.mcap"));
      const opened = await open(`#/assets/${asset}/import`);
      const { page } = opened;
      await page.setInputFiles("#upload-file", [
        { name: "again.mcap", mimeType: "application/mcap", buffer },
        { name: "twice.mcap", mimeType: "application/mcap", buffer },
      ]);
      const words = `A record with the start of its first record already exists on channel ${items[0].channel}`;
      // the other file's card names this one too
      await card(page, "again.mcap").getByText(words).first().waitFor();
      await card(page, "again.mcap").getByText("Same start and channel as twice.mcap").waitFor();
      await close(opened, name);
    },

    "a recording in the server's folder is replayed, listed and stopped": async (name) => {
      const opened = await desk();
      const { id, page } = opened;
      const files = page.getByLabel("File in the replay folder");
      await files
        .locator("option", { hasText: /^shift.mcap, [\d.]+ [KM]iB$/ })
        .waitFor({ state: "attached" });
      assert.equal(await files.locator("option").count(), 1, "the list is whole");
      const start = page.getByRole("button", { name: "Start replay" });
      await page.getByLabel("Pace").selectOption("realtime");
      await start.click();
      const item = page.locator(".replays li");
      await item.getByText("running", { exact: true }).waitFor();
      await item.getByRole("progressbar", { name: "Replay of shift.mcap" }).waitFor();
      await shoot(page, `${name} running`);
      await item.getByRole("button", { name: "Stop" }).click();
      await page.locator('.replays li[data-state="stopped"]').waitFor();
      assert.ok((await json(`assets/${id}`)).summary.segments < 6, "it ended early");
      await page.getByLabel("Pace").selectOption("max");
      await start.click();
      await page.locator('.replays li[data-state="finished"]').getByText("6 of 6 records").waitFor();
      await counted(item, 2);
      assert.equal((await json(`assets/${id}`)).summary.segments, 6);
      await end(opened, name);
    },
  }),

  "an empty replay folder says where it is": async () => {
    const id = await createAsset("import", {});
    const { page } = await open(`#/assets/${id}/import`, {}, (page) =>
      page.route("**/v1/replay-files", (route) => route.fulfill({ json: { items: [] } })),
    );
    await page.getByText("It is the folder “recordings” in the data folder").waitFor();
    for (const label of ["File in the replay folder", "Name in the replay folder"])
      assert.ok(await page.getByLabel(label).isHidden());
    await page.context().close();
    await removeAsset(id);
  },

  "a file of a long replay folder is given by its name": async () => {
    const items = Array.from({ length: 1000 }, (_, n) => ({
      file: `${n}.mcap`,
      bytes: 1000 + n,
      modified: "2026-03-01T08:00:00Z",
    }));
    const id = await createAsset("import", {});
    const { page } = await open(`#/assets/${id}/import`, {}, (page) =>
      page.route("**/v1/replay-files", (route) => route.fulfill({ json: { items } })),
    );
    await page.getByLabel("File in the replay folder").selectOption("Another file, by name…");
    await page.getByLabel("Name in the replay folder").fill("old.mcap");
    const sent = page.waitForRequest(
      (request) => request.method() === "POST" && request.url().endsWith("/v1/replays"),
    );
    await page.getByRole("button", { name: "Start replay" }).click();
    assert.equal((await sent).postDataJSON().file, "old.mcap");
    await page.context().close();
    await removeAsset(id);
  },

  "a refusal to list the replays is shown until they are listed": async () => {
    const before = (page) =>
      page.route(/\/v1\/replays\b/, (route) =>
        route.fulfill({ status: 403, json: { detail: "not allowed" } }),
      );
    const { page } = await open(`#/assets/${asset}/import`, {}, before);
    const words = page.locator('.result[data-kind="bad"]', { hasText: "not allowed" });
    await words.waitFor();
    await page.unroute(/\/v1\/replays\b/);
    await page.evaluate(() => document.dispatchEvent(new CustomEvent("recordschange")));
    await words.waitFor({ state: "hidden" });
    await page.context().close();
  },

  "an import is undone after a reload of the page": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("b_20260401_090000.wav", wav(2100)),
      audio("c_20260401_100000.wav", wav(2200)),
    ]);
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 3 records…" }).waitFor();
    await page.reload();
    const undo = page.getByRole("button", { name: /^Undo the import of 20.* UTC: delete 3 records…$/ });
    await undo.waitFor();
    await shoot(page, name);
    // a record deleted meanwhile is no obstacle
    const { items } = await json(`assets/${id}/segments`);
    const answer = await fetch(`${base}/v1/segments/${items[0].id}`, { method: "DELETE" });
    assert.ok(answer.ok, answer.statusText);
    page.on("dialog", (dialog) => dialog.accept());
    await undo.click();
    await page.getByText("2 records deleted. Import undone.").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 0);
    await page.reload();
    await page.getByText("Drop recordings or folders").waitFor();
    assert.ok(await page.getByRole("button", { name: /^Undo/ }).isHidden(), "it is undone only once");
    const missing = /^console: [^,]* 404 [^,]*$/;
    assert.ok(
      opened.faults.splice(0).every((fault) => missing.test(fault)),
      "only the missing record is reported",
    );
    await end(opened, name);
  },

  "files without a start time are placed at an interval, in the order of their names": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    const spacing = page.locator(".spacing");
    await page.setInputFiles("#upload-file", [
      audio("run-10.wav", wav(2300)),
      audio("run-2.wav", wav(2100)),
      audio("run-1.wav", wav(2000)),
      audio("dated_20260401_080000.wav", wav(2200)),
    ]);
    await spacing.getByText("3 files have no recording time").waitFor();
    // until a start is entered, the last record is as old as the latest file: the service takes none of the
    // future
    const offered = async () => Date.parse(`${await spacing.getByLabel("First record, UTC").inputValue()}Z`);
    const last = async () =>
      Date.parse(
        /Last record: (\S+) (\S+) UTC/
          .exec(await spacing.innerText())
          .slice(1)
          .join("T") + "Z",
      );
    for (const minutes of [60, 90]) {
      await spacing.getByLabel("Interval, minutes").fill(String(minutes));
      await spacing.getByLabel("Interval, minutes").blur();
      assert.equal((await last()) - (await offered()), 2 * minutes * 60_000);
      assert.ok(Math.abs((await last()) - Date.now()) < 600_000);
      assert.ok((await last()) <= Date.now());
    }
    await spacing.getByLabel("First record, UTC").fill("2099-05-01T06:00:00");
    await spacing.getByLabel("Interval, minutes").focus();
    await spacing.getByText("Last record: 2099-05-01 09:00:00 UTC, which is in the future.").waitFor();
    await spacing.getByLabel("First record, UTC").fill("2026-05-01T06:00:00");
    await spacing.getByLabel("Interval, minutes").fill("90");
    await shoot(page, name);
    // without them the files would stand at one moment
    const asked = page.waitForEvent("dialog");
    const sent = send(page);
    const dialog = await asked;
    assert.match(dialog.message(), /^3 files have no recording time, and were all written within/);
    await dialog.dismiss();
    await sent;
    assert.equal((await json(`assets/${id}`)).summary.segments, 0);
    await spacing.getByRole("button", { name: "Set start times" }).click();
    await card(page, "run-10.wav").getByText("at the interval entered").waitFor();
    await send(page);
    await page.getByText("4 files read: 4 records added.").waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual(
      items.map(({ start_time: start, samples }) => [start, samples]),
      [
        ["2026-04-01T08:00:00Z", 2200],
        ["2026-05-01T06:00:00Z", 2000],
        ["2026-05-01T07:30:00Z", 2100],
        ["2026-05-01T09:00:00Z", 2300],
      ],
    );
    await end(opened, name);
  },

  "start times are in the selected time zone": async () => {
    const opened = await desk();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [audio("dated_20260401_080000.wav", wav(2200))]);
    const dated = (zone) => page.getByLabel(`Start of dated_20260401_080000.wav, ${zone}`);
    assert.equal(await dated("UTC").inputValue(), "2026-04-01T08:00");
    await page.getByLabel("Times in").selectOption("local");
    const shown = await dated("local time").inputValue();
    assert.equal(await page.evaluate((text) => Date.parse(text), shown), Date.parse("2026-04-01T08:00Z"));
    await page.setInputFiles("#upload-file", [audio("run-1.wav", wav(2000)), audio("run-2.wav", wav(2100))]);
    const first = page.getByLabel("First record, local time");
    await first.fill("2026-05-01T06:00:00");
    await page.getByRole("button", { name: "Set start times" }).click();
    await send(page);
    await page.getByText("3 files read: 3 records added.").waitFor();
    const starts = (await json(`assets/${id}/segments`)).items.map(({ start_time: start }) => start);
    const local = await page.evaluate(() => Date.parse("2026-05-01T06:00:00"));
    assert.deepEqual(
      starts.map((start) => Date.parse(start)),
      [Date.parse("2026-04-01T08:00Z"), local, local + 3_600_000],
    );
    await end(opened);
  },

  "files that do not reach the server are listed again": async () => {
    const opened = await desk();
    const { page } = opened;
    await page.route("**/segments?**", (route) =>
      route.request().method() === "POST" ? route.abort() : route.continue(),
    );
    await page.setInputFiles("#upload-file", [audio("a_20260401_080000.wav", wav(2000))]);
    await send(page);
    await page
      .getByText("a_20260401_080000.wav could not be sent: connection lost during the upload; try again.")
      .waitFor();
    await page.getByText("Files that were not sent are listed again.").waitFor();
    await page.unroute("**/segments?**");
    await send(page);
    await good(page, "a_20260401_080000.wav: record of");
    opened.faults.splice(0);
    await end(opened);
  },

  "the cards of many files are folded, but for one with an error": async (name) => {
    const opened = await desk();
    const { page } = opened;
    const files = Array.from({ length: 9 }, (_, n) => audio(`run_20260401_08${10 + n}00.wav`, wav(2000)));
    await page.setInputFiles("#upload-file", [...files, audio("broken.wav", Buffer.from("no recording"))]);
    await page.getByRole("button", { name: "Upload 10 files" }).waitFor();
    const first = card(page, files[0].name);
    await first.getByText("· 2026-04-01 08:10:00 UTC").waitFor();
    const start = (file) => page.getByLabel(`Start of ${file}, UTC`);
    assert.ok(await start(files[0].name).isHidden());
    assert.ok(await start("broken.wav").isVisible());
    await shoot(page, name);
    await first.locator("summary").click();
    await start(files[0].name).fill("2026-04-02T08:00");
    await first.locator("summary").click();
    await first.getByText("· 2026-04-02 08:00:00 UTC").waitFor();
    await end(opened);
  },

  "a rejected file is listed again, and taken with what it lacked": async (name) => {
    const opened = await desk();
    const { page } = opened;
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("broken.wav", Buffer.from("no recording")),
      table("untimed_20260401_090000.csv", "a1\n1\n2\n3\n1"),
    ]);
    await send(page);
    await page
      .getByText("3 files read: 1 record added, 2 files rejected. Rejected files are listed")
      .waitFor();
    assert.equal(await page.locator(".files > li").count(), 1, "a file that cannot be read is not");
    await shoot(page, name);
    await page.getByLabel("Sampling rate of a CSV").fill("1000");
    await page.getByLabel("Sampling rate of a CSV").blur();
    await card(page, "untimed_20260401_090000.csv").getByText("1000 Hz (entered)").waitFor();
    await send(page);
    await good(page, "untimed_20260401_090000.csv: record of 2026-04-01 09:00:00 UTC");
    assert.match(opened.faults.splice(0).join(), /^console: [^,]* 422 [^,]*,console: [^,]* 422 [^,]*$/);
    await end(opened);
  },

  "the unit of the samples is asked for before the first records": async (name) => {
    const opened = await desk({ sensor: undefined });
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [audio("a_20260401_080000.wav", wav(2000))]);
    const note = page.getByText("The files do not name the unit of their samples");
    await note.waitFor();
    await shoot(page, name);
    await page.getByLabel("Unit", { exact: true }).first().fill("g");
    await page.getByLabel("Unit", { exact: true }).first().fill("");
    await note.waitFor();
    const asked = page.waitForEvent("dialog");
    const sent = send(page);
    const dialog = await asked;
    assert.match(dialog.message(), /^The samples of a_20260401_080000\.wav have no unit/);
    await dialog.dismiss();
    await sent;
    assert.equal((await json(`assets/${id}`)).summary.segments, 0);
    await page.getByLabel("Unit", { exact: true }).first().fill("g");
    await send(page);
    await good(page, "a_20260401_080000.wav: record of");
    const { items } = await json(`assets/${id}/segments`);
    assert.equal(items[0].unit, "g");
    await end(opened, name);
    // an asset with a unit needs no question
    const other = await desk();
    await other.page.setInputFiles("#upload-file", [audio("a_20260401_080000.wav", wav(2000))]);
    await other.page.getByRole("button", { name: "Upload file" }).waitFor();
    assert.ok(await other.page.getByText("The files do not name").isHidden());
    await end(other);
  },

  "a start to the microsecond is shown, kept, and undone": async () => {
    const opened = await desk();
    const { id, page } = opened;
    const time = (n) => `2026-03-01T08:00:01.${String(123_456 + 250 * n).padStart(6, "0")}Z`;
    const rows = Array.from({ length: 2000 }, (_, n) => `${time(n)},${Math.sin(0.4 * n)}`);
    await page.setInputFiles("#upload-file", [table("fine.csv", ["time,a1", ...rows].join("\n"))]);
    await card(page, "fine.csv").getByText("from its time column").waitFor();
    const start = page.getByLabel("Start of fine.csv, UTC");
    assert.equal(await start.inputValue(), "2026-03-01T08:00:01.123");
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 1 record" }).waitFor();
    const [stored] = (await json(`assets/${id}/segments`)).items;
    assert.equal(stored.start_time, time(0));
    // another column of times has another start
    const relative = ["time,s,a1", ...rows.map((row, n) => row.replace(",", `,${n / 4000},`))].join("\n");
    await page.setInputFiles("#upload-file", [table("2026-03-02.csv", relative)]);
    await page.getByLabel("Column time of 2026-03-02.csv").selectOption("left_out");
    await page.getByLabel("Column s of 2026-03-02.csv").selectOption("time");
    await card(page, "2026-03-02").getByText("from the file name, read as UTC").waitFor();
    assert.equal(await page.getByLabel("Start of 2026-03-02.csv, UTC").inputValue(), "2026-03-02T00:00");
    await end(opened);
  },

  "an entry that is not a number is not left out of an upload": async (name) => {
    const opened = await desk({ sensor: {} });
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [audio("pump_20260301_080000.wav", wav(4000))]);
    await page.getByText("The files do not name the unit of their samples").waitFor();
    page.on("dialog", (dialog) => dialog.accept()); // there is no unit
    const speed = page.getByLabel("Shaft speed, rpm");
    await speed.pressSequentially("1e");
    await send(page);
    await page.getByText("Nothing was uploaded: “Shaft speed, rpm” is not a number.").waitFor();
    assert.deepEqual(await speed.evaluate((field) => [field === document.activeElement, field.ariaInvalid]), [
      true,
      "true",
    ]);
    await speed.fill("600");
    await page.getByLabel("Full scale of pump_20260301_080000.wav").pressSequentially("--5");
    await send(page);
    await page.getByText("“Full scale of pump_20260301_080000.wav” is not a number.").waitFor();
    assert.equal((await json(`assets/${id}/segments`)).items.length, 0);
    await page.getByLabel("Full scale of pump_20260301_080000.wav").fill("5");
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 1 record" }).waitFor();
    const [{ shaft_speed: known }] = (await json(`assets/${id}/segments`)).items;
    assert.deepEqual([known.shaft_speed_hz, known.source], [10, "record"]);
    await end(opened, name);
  },

  "existing records are reported and not removed by undo": async () => {
    const opened = await desk();
    const { id, page } = opened;
    const file = audio("a_20260401_080000.wav", wav(2000));
    const sent = await fetch(`${base}/v1/assets/${id}/segments?start_time=2026-04-01T08:00:00Z&unit=m/s2`, {
      method: "POST",
      headers: { "content-type": "audio/wav" },
      body: file.buffer,
    });
    assert.equal(sent.status, 201);
    await page.setInputFiles("#upload-file", [file]);
    await card(page, "a_20260401").getByText("A record with this start already exists on channel").waitFor();
    await page.locator("summary", { hasText: "sampling rate" }).click();
    await page.getByLabel("Unit", { exact: true }).first().fill("m/s2");
    await send(page);
    await good(page, "a_20260401_080000.wav: record of");
    assert.ok(await page.getByRole("button", { name: /Undo this import/ }).isHidden());
    assert.equal((await json(`assets/${id}`)).summary.segments, 1);
    await end(opened);
  },

  "columns, channels and units of a CSV file are mapped": async (name) => {
    const opened = await desk();
    const { id, page } = opened;
    const text = [
      "n;in [g];out (m/s2);speed",
      ...Array.from({ length: 600 }, (_, n) => `${n};${Math.sin(n)};${Math.cos(n * 0.3)};25`),
    ].join("\n");
    await page.setInputFiles("#upload-file", [table("c_20260401_080000.csv", text)]);
    const file = card(page, "c_20260401");
    await file.getByText(/Line 1: column "n" rises by the same step from line to line/).waitFor();
    const column = (heading) => file.getByLabel(`Column ${heading} of c_20260401_080000.csv`);
    let hold = 600; // ms; the answers come in the reverse order of the choices
    await page.route("**/csv-preview*", async (route) => {
      hold -= 150;
      await new Promise((resolve) => setTimeout(resolve, hold));
      await route.continue();
    });
    for (const heading of ["in [g]", "out (m/s2)"]) await column(heading).selectOption("channel");
    await column("n").selectOption("ignored");
    await column("speed").selectOption("ignored");
    await file.getByText("CSV · 2 channels").waitFor();
    await page.waitForTimeout(700);
    await file.getByText("CSV · 2 channels").waitFor();
    await page.unroute("**/csv-preview*");
    assert.equal(await file.getByLabel("Unit of in of").inputValue(), "g");
    await file.getByLabel("Name of out of").fill("gear-side");
    // the values for all files unfold by themselves, as the rate is missing
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("2560.5");
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").blur();
    await file.getByText("CSV · 2 channels · 2560.5 Hz (entered)").waitFor();
    await shoot(page, `${name} mapped`);
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 2 records…" }).waitFor();
    const { items } = await json(`assets/${id}/segments`);
    const told = items
      .map(({ channel, unit, sample_rate_hz: rate, samples, indicators }) => [
        channel,
        unit,
        rate,
        samples,
        indicators.rms.toFixed(1),
      ])
      .sort();
    assert.deepEqual(
      told,
      [
        ["gear-side", "m/s2", 2560.5, 600, "0.7"],
        ["in", "m/s2", 2560.5, 600, "6.9"],
      ],
      "a channel in g is brought to the asset's unit",
    );
    await end(opened, name);
  },

  "a CSV file of two units of which one is refused is undone": async () => {
    const opened = await desk();
    const { id, page } = opened;
    const text = ["in;out", ...Array.from({ length: 600 }, (_, n) => `${n % 7};${n % 5}`)];
    await page.setInputFiles("#upload-file", [table("u_20260401_080000.csv", text.join("\n"))]);
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("2560");
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").blur();
    await card(page, "u_20260401").getByText("CSV · 2 channels · 2560 Hz (entered)").waitFor();
    await card(page, "u_20260401").getByLabel("Unit of in of").fill("g");
    await card(page, "u_20260401").getByLabel("Unit of out of").fill("m/s2");
    const refused = { title: "Unprocessable", detail: "it has too few samples" };
    await page.route(/segments\?.*columns=2/, (route) => route.fulfill({ status: 422, json: refused }));
    await send(page);
    const part = page.locator('.result[data-kind="part"]');
    await part.getByText("u_20260401_080000.csv: record of").waitFor();
    await part
      .getByText("The part of u_20260401_080000.csv in m/s2 was rejected: it has too few samples")
      .waitFor();
    page.on("dialog", (dialog) => dialog.accept());
    await page.getByRole("button", { name: "Undo this import: delete 1 record…" }).click();
    await page.getByText("1 record deleted. Import undone.").waitFor();
    assert.equal((await json(`assets/${id}`)).summary.segments, 0);
    await opened.page.context().close();
    await removeAsset(id);
  },

  "a MATLAB file is uploaded with the entered rate and names": async () => {
    const opened = await desk();
    const { id, page } = opened;
    const buffer = await readFile(new URL("../../fixtures/matlab/bearing-two-channels.mat", import.meta.url));
    const name = "m_20260401_080000.mat";
    await page.setInputFiles("#upload-file", [{ name, mimeType: "application/octet-stream", buffer }]);
    await card(page, "m_20260401").locator('.result[data-kind="bad"]').waitFor();
    // the field that it lacks is open
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").fill("12000");
    await page.getByLabel("Sampling rate of a CSV, MATLAB or NumPy file, Hz").blur();
    for (const [own, chosen] of [
      ["X097_DE_time", "drive end"],
      ["X097_FE_time", "fan end"],
    ])
      await page.getByLabel(`Name of ${own} of ${name}`).fill(chosen);
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 2 records…" }).waitFor();
    const { items } = await json(`assets/${id}/segments`);
    assert.deepEqual(items.map(({ channel, sample_rate_hz: rate }) => [channel, rate]).sort(), [
      ["drive end", 12000],
      ["fan end", 12000],
    ]);
    await end(opened, "matlab");
  },

  "each channel of a WAV file has its own unit": async () => {
    const opened = await desk();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [audio("two_20260401_080000.wav", stereo(2000))]);
    await page.getByLabel("Unit of 2 of two_20260401_080000.wav").fill("g");
    await page.getByLabel("Name of 1 of two_20260401_080000.wav").fill("gear side");
    await send(page);
    await page.getByRole("button", { name: "Undo this import: delete 2 records…" }).waitFor();
    const { items } = await json(`assets/${id}/segments`);
    const strength = Object.fromEntries(items.map(({ channel, indicators }) => [channel, indicators.rms]));
    const [first, second] = [9000, 3000].map((counts) => counts / 32768 / Math.SQRT2);
    // a channel in g is converted to the asset's unit
    assert.ok(Math.abs(strength["gear side"] / first - 1) < 0.01, JSON.stringify(strength));
    assert.ok(Math.abs(strength["2"] / (9.80665 * second) - 1) < 0.01, JSON.stringify(strength));
    await end(opened);
  },

  "the full scale of integer files is applied, to all or to one, and a sensitivity": async () => {
    const opened = await desk();
    const { id, page } = opened;
    await page.setInputFiles("#upload-file", [
      audio("a_20260401_080000.wav", wav(2000)),
      audio("b_20260401_090000.wav", deep(wav(2000))),
    ]);
    await page.getByText("Details missing from the files").click();
    await page.getByLabel("Full scale of integer WAV and FLAC files, in the unit").fill("20");
    await page.getByLabel("Full scale of a_20260401_080000.wav").fill("50");
    await send(page);
    await good(page, "b_20260401_090000.wav: record of");
    const { items } = await json(`assets/${id}/segments`);
    for (const [n, scale] of [50, 20].entries()) {
      const wave = await json(`segments/${items[n].id}/waveform?max_points=4000`);
      const greatest = Math.max(...wave.value);
      assert.ok(
        greatest > scale * 0.3 && greatest < scale * 0.4,
        `9000 of 32768 counts, twice where both lines add up: ${greatest} of ${scale}`,
      );
    }
    // a table of numbers has no full scale
    await page.setInputFiles("#upload-file", [table("c_20260401_100000.csv", csv(2000))]);
    const asked = page.waitForEvent("dialog");
    const sent = send(page);
    const dialog = await asked;
    assert.match(dialog.message(), /^c_20260401_100000\.csv does not use the full scale, which is for WAV/);
    await dialog.dismiss();
    await sent;
    await page.getByLabel("Full scale of integer WAV and FLAC files, in the unit").fill("");
    await page.getByLabel("Sensitivity of the sensor, mV/g").fill("100");
    await send(page);
    await good(page, "c_20260401_100000.csv: record of");
    const latest = (await json(`assets/${id}/segments`)).items.at(-1);
    const volts = (await json(`segments/${items[1].id}/waveform?max_points=4000`)).value;
    const { value } = await json(`segments/${latest.id}/waveform?max_points=4000`);
    const ratio = Math.max(...value) / (Math.max(...volts) / ((20 * 9000) / 32768));
    assert.ok(Math.abs(ratio / (10 * 9.80665) - 1) < 0.01, `10 g for 1 V, in m/s²: ${ratio}`);
    await end(opened);
  },

  "a large WAV file is read in slices": async () => {
    const opened = await desk();
    const { page } = opened;
    const read = await page.evaluate(async () => {
      const { wavHead, wavSketch } = await import("./static/wav-head.js");
      const seconds = 1000;
      const size = 2 * 48000 * seconds;
      const head = new DataView(new ArrayBuffer(44));
      const text = (at, word) =>
        [...word].forEach((letter, n) => head.setUint8(at + n, letter.charCodeAt(0)));
      text(0, "RIFF");
      text(8, "WAVEfmt ");
      text(36, "data");
      [
        [16, 16],
        [24, 48000],
        [28, 96000],
        [40, size],
      ].forEach(([at, value]) => head.setUint32(at, value, true));
      [
        [20, 1],
        [22, 1],
        [32, 2],
        [34, 16],
      ].forEach(([at, value]) => head.setUint16(at, value, true));
      let bytes = 0;
      const file = {
        size: 44 + size,
        slice: (from, to) => {
          bytes += to - from;
          return from < 44
            ? new Blob([head.buffer.slice(from, Math.min(44, to))])
            : new Blob([new Int16Array((to - from) / 2).map((_, n) => 16384 * Math.sin(n))]);
        },
      };
      const found = await wavHead(file);
      const sketch = await wavSketch(file, found, 0);
      return {
        seconds: found.frames / found.rate,
        columns: sketch.columns.length,
        greatest: Math.max(...sketch.columns.map(([, high]) => high)),
        whole: sketch.whole,
        bytes,
      };
    });
    assert.equal(read.seconds, 1000);
    assert.deepEqual([read.columns, read.whole], [240, false]);
    assert.ok(Math.abs(read.greatest - 0.5) < 0.01 && read.bytes < 2e6, JSON.stringify(read));
    await end(opened);
  },

  "files dropped on the import page are listed there": async (name) => {
    const opened = await desk();
    const { page } = opened;
    await page.getByText("Drop recordings or folders of them here").waitFor();
    await drop(page, { "dropped.wav": wav(1000) });
    await card(page, "dropped.wav").getByText("4000 Hz").waitFor();
    assert.equal(await page.locator("dialog[open]").count(), 0);
    await end(opened, name);
  },

  "the import page on a phone": async (name) => {
    const id = await createAsset("import", {});
    const opened = await open(`#/assets/${id}/import`, PHONE);
    await opened.page.setInputFiles("#upload-file", [
      audio("two_20260401_080000.wav", stereo(4000)),
      table("samples.csv", csv(1000)),
    ]);
    await opened.page.getByRole("button", { name: "Upload 2 files" }).waitFor();
    await noSidewaysScrolling(opened.page);
    await end({ id, ...opened }, name);
  },
};
