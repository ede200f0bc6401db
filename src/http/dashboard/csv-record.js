// A CSV file of samples as 32-bit floats, which the server takes: each column is a channel, no sample changes
// but by rounding to 32 bits.

import { stampSeconds, startOf, timeColumn } from "./csv-time.js";

const MOST_BYTES = 64 * 1024 * 1024;
const HEAD = 64 * 1024; // bytes that hold the headings and the first row
const SAME_RATE = 1e-3; // of the rate that is typed in, for times are often rounded

/** What is wrong with a CSV file, in words for the person who dropped it. */
export class CsvError extends Error {}

function cells(line, separator) {
  return line.split(separator).map((cell) => cell.trim().replace(/^"(.*)"$/, "$1"));
}

function numberAt(text, line, column, comma) {
  const value = text === "" ? NaN : Number(comma ? text.replace(",", ".") : text);
  if (Number.isFinite(value)) return value;
  throw new CsvError(`line ${line}, column “${column}” is “${text}”, expected a finite number`);
}

/** How the lines of a CSV file are to be read. */
function formOf(lines) {
  const separator = lines[0].includes(";") ? ";" : lines[0].includes("\t") ? "\t" : ",";
  const comma = separator !== ",";
  const first = cells(lines[0], separator);
  const isNumber = (cell) => cell !== "" && Number.isFinite(Number(comma ? cell.replace(",", ".") : cell));
  const headed = !first.every(
    (cell, column) => isNumber(cell) || (column === 0 && !Number.isNaN(stampSeconds(cell))),
  );
  const names = headed ? first : first.map((_, index) => String(index + 1));
  const stamps = !Number.isNaN(stampSeconds(cells(lines[headed ? 1 : 0] ?? "", separator)[0]));
  return { separator, comma, headed, names, stamps };
}

function linesOf(text) {
  const lines = text.replace(/^\ufeff/, "").split(/\r?\n/);
  while (lines.length && !lines.at(-1).trim()) lines.pop();
  return lines;
}

/** Rows of numbers with their headings; `stamps` says that the first column held dates, which are seconds since the first one now. */
export function parseCsv(text) {
  const lines = linesOf(text);
  if (lines.length < 2)
    throw new CsvError(
      `the file has ${lines.length} ${lines.length === 1 ? "line" : "lines"}, expected samples in rows`,
    );
  const { separator, comma, headed, names, stamps } = formOf(lines);
  const begin = headed ? 1 : 0;
  const columns = names.map(() => new Float64Array(lines.length - begin));
  const origin = stamps ? stampSeconds(cells(lines[begin], separator)[0]) : 0;
  for (let line = begin; line < lines.length; line++) {
    const row = cells(lines[line], separator);
    if (row.length !== names.length)
      throw new CsvError(
        `line ${line + 1} has ${row.length} values, expected ${names.length} as in the first line`,
      );
    row.forEach((cell, column) => {
      const stamp = stamps && column === 0;
      const value = stamp ? stampSeconds(cell) - origin : numberAt(cell, line + 1, names[column], comma);
      if (Number.isNaN(value))
        throw new CsvError(
          `line ${line + 1}, column “${names[column]}” is “${cell}”, expected a time as in the first row`,
        );
      columns[column][line - begin] = value;
    });
  }
  return { names, columns, stamps };
}

/** When a CSV file says that it begins, as an ISO time; null where it does not. */
export async function csvStart(file) {
  const lines = linesOf(await file.slice(0, HEAD).text());
  if (lines.length < 2) return null;
  const { separator, comma, headed, names, stamps } = formOf(lines);
  const first = cells(lines[headed ? 1 : 0], separator)[0];
  if (stamps) return new Date(Math.round(1000 * stampSeconds(first))).toISOString();
  return startOf(names[0], Number(comma ? first.replace(",", ".") : first));
}

/** A WAV file of 32-bit floats. */
export function floatWav(channels, rate) {
  const frames = channels[0].length;
  const size = 4 * channels.length * frames;
  const view = new DataView(new ArrayBuffer(44 + size));
  const text = (at, word) => [...word].forEach((letter, n) => view.setUint8(at + n, letter.charCodeAt(0)));
  const block = 4 * channels.length;
  text(0, "RIFF");
  view.setUint32(4, 36 + size, true);
  text(8, "WAVEfmt ");
  [
    [16, 16, 32],
    [20, 3, 16],
    [22, channels.length, 16],
    [24, rate, 32],
    [28, rate * block, 32],
    [32, block, 16],
    [34, 32, 16],
  ].forEach(([at, value, bits]) =>
    bits === 32 ? view.setUint32(at, value, true) : view.setUint16(at, value, true),
  );
  text(36, "data");
  view.setUint32(40, size, true);
  for (let frame = 0; frame < frames; frame++)
    channels.forEach((channel, n) => view.setFloat32(44 + frame * block + 4 * n, channel[frame], true));
  return new Blob([view], { type: "audio/wav" });
}

/** 32-bit floats without a head, channels interleaved: these take any rate. */
function bareFloats(channels) {
  const floats = new Float32Array(channels.length * channels[0].length);
  channels.forEach((channel, n) =>
    channel.forEach((value, frame) => (floats[frame * channels.length + n] = value)),
  );
  return new Blob([floats]);
}

/**
 * The columns of a CSV file: `{ rate, names, time, channels }`, the rate in hertz or undefined, `time` the place of the time column, -1 without, and for
 * each channel `{ place, values }`. `roles` says of each column whether it is the "time", a "channel" or left out; where it is not given that is looked
 * for. A `rate` has to agree with that of the time column where there is one.
 */
export function channelsOfCsv(text, rate, roles) {
  const { names, columns, stamps } = parseCsv(text);
  const time = timeColumn(names, columns, stamps, roles?.indexOf("time"));
  if (time.words) throw Object.assign(new CsvError(time.words), { names });
  if (rate && time.rate && Math.abs(time.rate - rate) > SAME_RATE * rate)
    throw new CsvError(
      `the sampling rate is ${rate} Hz, expected ${Number(time.rate.toPrecision(6))} Hz as column “${names[time.index]}” says`,
    );
  const channels = columns
    .map((values, place) => ({ place, values }))
    .filter(({ place }) => (roles ? roles[place] === "channel" : place !== time.index));
  if (channels.length === 0)
    throw Object.assign(new CsvError("there is no column beside the time, expected one with samples"), {
      names,
    });
  return { rate: rate || time.rate, names, time: time.index, channels };
}

/** The text of a CSV file; of a large one its begin, up to the end of a line. */
export async function csvBegin(file, most) {
  const text = await file.slice(0, most).text();
  return file.size > most ? text.slice(0, text.lastIndexOf("\n") + 1) : text;
}

/**
 * The chosen columns of a CSV file as what is sent: `{ body, type, parameters }`. `rate` in hertz is needed where no column is the time; `roles` as
 * for `channelsOfCsv`, of which the columns at the places `chosen` are taken.
 */
export async function recordOfCsv(file, rate, roles, chosen) {
  if (file.size > MOST_BYTES)
    throw new CsvError(
      `the file has ${Math.round(file.size / 1e6)} MB, expected at most 64 MB here; “flankwatch convert” takes larger ones`,
    );
  const { rate: known, names, channels: all } = channelsOfCsv(await file.text(), rate, roles);
  if (!known)
    throw new CsvError(
      `no column is the time (columns: ${names.join(", ")}), so the sampling rate is needed: type it in above`,
    );
  const channels = all.filter(({ place }) => !chosen || chosen.includes(place)).map(({ values }) => values);
  // a WAV file holds whole rates only
  if (Math.abs(known - Math.round(known)) <= 1e-4 * known)
    return { body: floatWav(channels, Math.round(known)), type: "audio/wav", parameters: {} };
  return {
    body: bareFloats(channels),
    type: "application/octet-stream",
    parameters: { sample: "f32", sample_rate_hz: known, channels: channels.length },
  };
}
