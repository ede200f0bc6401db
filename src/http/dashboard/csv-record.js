// A CSV file of samples as a WAV file of 32-bit floats, which the server takes: each column is a channel, no sample changes but by rounding to
// 32 bits.

const MOST_BYTES = 64 * 1024 * 1024;
const TIME = /^(t|time)([ _]?[([]?s(econds)?[)\]]?)?$/i;

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

/** Rows of numbers with their headings. */
export function parseCsv(text) {
  const lines = text.replace(/^\ufeff/, "").split(/\r?\n/);
  while (lines.length && !lines.at(-1).trim()) lines.pop();
  if (lines.length < 2) throw new CsvError(`the file has ${lines.length} ${lines.length === 1 ? "line" : "lines"}, expected samples in rows`);
  const separator = lines[0].includes(";") ? ";" : lines[0].includes("\t") ? "\t" : ",";
  const comma = separator !== ",";
  const first = cells(lines[0], separator);
  const headed = first.some((cell) => cell === "" || !Number.isFinite(Number(comma ? cell.replace(",", ".") : cell)));
  const names = headed ? first : first.map((_, index) => String(index + 1));
  const columns = names.map(() => new Float64Array(lines.length - (headed ? 1 : 0)));
  for (let line = headed ? 1 : 0; line < lines.length; line++) {
    const row = cells(lines[line], separator);
    if (row.length !== names.length) throw new CsvError(`line ${line + 1} has ${row.length} values, expected ${names.length} as in the first line`);
    row.forEach((cell, column) => (columns[column][line - (headed ? 1 : 0)] = numberAt(cell, line + 1, names[column], comma)));
  }
  return { names, columns };
}

/** The rate that a column of times tells, in hertz. */
function rateOf(times) {
  const steps = times.length - 1;
  const rate = steps / (times[steps] - times[0]);
  if (!(rate > 0 && Number.isFinite(rate))) throw new CsvError(`the times run from ${times[0]} to ${times[steps]} s, expected rising times in seconds`);
  for (let n = 0; n < steps; n++) {
    const step = (times[n + 1] - times[n]) * rate;
    if (step < 0.5 || step > 1.5) throw new CsvError(`between rows ${n + 1} and ${n + 2} the time goes on by ${times[n + 1] - times[n]} s, expected ${1 / rate} s as on average: samples are missing`);
  }
  return rate;
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
  [[16, 16, 32], [20, 3, 16], [22, channels.length, 16], [24, rate, 32], [28, rate * block, 32], [32, block, 16], [34, 32, 16]].forEach(([at, value, bits]) => (bits === 32 ? view.setUint32(at, value, true) : view.setUint16(at, value, true)));
  text(36, "data");
  view.setUint32(40, size, true);
  for (let frame = 0; frame < frames; frame++) channels.forEach((channel, n) => view.setFloat32(44 + frame * block + 4 * n, channel[frame], true));
  return new Blob([view], { type: "audio/wav" });
}

/** The WAV file of a CSV file; `rate` in hertz is needed where no column is called time. */
export async function wavOfCsv(file, rate) {
  if (file.size > MOST_BYTES) throw new CsvError(`the file has ${Math.round(file.size / 1e6)} MB, expected at most 64 MB here; “flankwatch convert” takes larger ones`);
  const { names, columns } = parseCsv(await file.text());
  const time = names.findIndex((name) => TIME.test(name.trim()));
  const known = rate || (time >= 0 ? rateOf(columns[time]) : 0);
  if (!known) throw new CsvError(`no column is called time (columns: ${names.join(", ")}), so the sampling rate is needed: type it in above`);
  const channels = columns.filter((_, index) => index !== time);
  if (channels.length === 0) throw new CsvError("there is no column beside the time, expected one with samples");
  if (Math.abs(known - Math.round(known)) > 1e-4 * known) throw new CsvError(`the sampling rate is ${known} Hz, which a WAV file cannot hold; “flankwatch convert” keeps it`);
  return floatWav(channels, Math.round(known));
}
