// What a file holds, as far as its begin and end say it: channels, rate, length, unit, start, and a sketch of
// the samples.

import { channelsOfCsv, csvBegin } from "./csv-record.js";
import { startOfFile } from "./file-start.js";
import { mcapSummary } from "./mcap-summary.js";
import { envelopeOf, wavHead, wavSketch } from "./wav-head.js";

export const TYPES = {
  wav: "audio/wav",
  csv: "text/csv",
  mcap: "application/mcap",
  json: "application/json",
  pb: "application/x-protobuf",
};
const OWN_TIMES = ["application/mcap", "application/json", "application/x-protobuf"]; // these say when each of their records began
const CSV_BEGIN = 512 * 1024;
const MOST_JSON = 16 * 1024 * 1024;
const MOST_SKETCHES = 8;

/** The media type of a file by its name, undefined where it is none that is taken. */
export const typeOf = (file) => TYPES[file.name.split(".").pop().toLowerCase()];

/** The name and unit in a column's heading: `a1 [m/s2]`, `a1 (g)`. */
export function headingParts(heading) {
  const [, name, unit] = /^(.*?)\s*[[(]\s*([^\])]{1,20})\s*[\])]\s*$/.exec(heading) ?? [null, heading, ""];
  return { name: name.trim() || heading.trim(), unit: unit.trim() };
}

async function ofWav(file) {
  const head = await wavHead(file);
  const sketches = [];
  for (let channel = 0; channel < Math.min(head.channels, MOST_SKETCHES); channel++)
    sketches.push(await wavSketch(file, head, channel));
  const channels = Array.from({ length: head.channels }, (_, n) => ({
    name: String(n + 1),
    unit: "",
    sketch: sketches[n] ?? null,
  }));
  const form = `${head.bits} bit ${head.format === 3 ? "floats" : "integers"}`;
  return { head, channels, rate: head.rate, seconds: head.frames / head.rate, form };
}

/** A CSV file under the roles of its columns; what is wrong with it is in `fault`, beside the columns where these could be read. */
async function ofCsv(file, rate, roles) {
  const text = await csvBegin(file, CSV_BEGIN);
  const whole = file.size <= CSV_BEGIN;
  try {
    const read = channelsOfCsv(text, rate, roles);
    const rows = read.channels[0].values.length;
    const channels = read.channels.map(({ place, values }) => ({
      place,
      ...headingParts(read.names[place]),
      sketch: { columns: envelopeOf(values), whole },
    }));
    const share = whole ? 1 : file.size / CSV_BEGIN;
    return {
      columns: read.names,
      time: read.time,
      channels,
      rate: read.rate,
      seconds: read.rate ? (rows * share) / read.rate : null,
      isEstimate: !whole,
      form: "CSV",
      rateFrom: read.time >= 0 ? `column “${read.names[read.time]}”` : "typed in",
    };
  } catch (error) {
    return { columns: error.names ?? [], channels: [], fault: error.message, form: "CSV" };
  }
}

async function ofMcap(file) {
  const summary = await mcapSummary(file);
  return {
    channels: [],
    summary,
    form: "MCAP",
    words: summary ? null : "it says nothing of its contents at its end; the service reads it whole",
  };
}

async function ofJson(file) {
  if (file.size > MOST_JSON) return { channels: [], form: "JSON", words: "too large to be looked at here" };
  const {
    start_time: start,
    sample_rate_hz: rate,
    unit = "",
    channel = "",
    samples,
  } = JSON.parse(await file.text());
  if (!Array.isArray(samples)) return { channels: [], form: "JSON", fault: "it has no samples" };
  return {
    channels: [{ name: channel, unit, sketch: { columns: envelopeOf(samples), whole: true } }],
    rate,
    seconds: samples.length / rate,
    form: "JSON",
    ownStart: start,
  };
}

const READERS = {
  "audio/wav": ofWav,
  "text/csv": ofCsv,
  "application/mcap": ofMcap,
  "application/json": ofJson,
};

/** What is known of a file before it is sent; `fault` says what is wrong with it. Nothing of it is thrown. */
export async function preview(file, rate, roles) {
  const type = typeOf(file);
  if (!type)
    return { type, channels: [], fault: "expected a file that ends in .wav, .mcap, .csv, .json or .pb" };
  const start = OWN_TIMES.includes(type) ? null : await startOfFile(file, type);
  try {
    return {
      type,
      start,
      ...((await READERS[type]?.(file, rate, roles)) ?? { channels: [], form: "protobuf" }),
    };
  } catch (error) {
    return { type, start, channels: [], fault: error.message };
  }
}
