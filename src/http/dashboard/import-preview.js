// Preview of a file from its start and end: channels, rate, length, unit, start, and a sketch of the samples.

import { previewCsv, previewRecording } from "./api.js";
import { startOfFile } from "./file-start.js";
import { mcapSummary } from "./mcap-summary.js";
import { bytes, number } from "./format.js";
import { envelopeOf, wavHead, wavSketch } from "./wav-head.js";

export const TYPES = {
  wav: "audio/wav",
  flac: "audio/flac",
  csv: "text/csv",
  mat: "application/x-matlab-data",
  npy: "application/x-npy",
  mcap: "application/mcap",
  json: "application/json",
  pb: "application/x-protobuf",
};
const OWN_TIMES = ["application/mcap", "application/json", "application/x-protobuf"]; // these contain the start of each record
const CSV_BEGIN = 512 * 1024;
const MAX_JSON = 16 * 1024 * 1024;
const MAX_SKETCHES = 8;
const MAX_RECORDING = 16 * 1024 * 1024; // largest recording that the service previews
const MCAP_BEGIN = 4 * 1024 * 1024;

const endingOf = (file) => file.name.split(".").pop().toLowerCase();

/** The media type of a file by its name; undefined when unsupported. */
const typeOf = (file) => TYPES[endingOf(file)];

/** The extensions of the files that can be imported. */
export const ENDINGS = [...Object.keys(TYPES), "csv.gz"].map((ending) => `.${ending}`);

/** Whether a file can be imported, by its name. */
export const isImportable = ({ name }) => ENDINGS.some((ending) => name.toLowerCase().endsWith(ending));

/** A compressed CSV file without its compression; any other file unchanged. */
export async function unpacked(file) {
  if (!file.name.toLowerCase().endsWith(".csv.gz")) return file;
  const contents = await new Response(file.stream().pipeThrough(new DecompressionStream("gzip"))).blob();
  return new File([contents], file.name.slice(0, -".gz".length), { lastModified: file.lastModified });
}

async function ofWav(file) {
  const head = await wavHead(file);
  const sketches = [];
  for (let channel = 0; channel < Math.min(head.channels, MAX_SKETCHES); channel++)
    sketches.push(await wavSketch(file, head, channel));
  const channels = Array.from({ length: head.channels }, (_, n) => ({
    name: String(n + 1),
    unit: "",
    sketch: sketches[n] ?? null,
  }));
  const form = `${head.bits} bit ${head.format === 3 ? "floats" : "integers"}`;
  const fault = head.lost
    ? `it is truncated: ${bytes(head.lost)} of the ${bytes(head.bytes + head.lost)} of samples that it declares are missing`
    : null;
  return { head, channels, rate: head.rate, seconds: head.frames / head.rate, form, fault };
}

/** The whole lines at the start of a file. */
async function firstLines(file) {
  const begin = new Uint8Array(await file.slice(0, CSV_BEGIN).arrayBuffer());
  return file.size > CSV_BEGIN ? begin.slice(0, begin.lastIndexOf(10) + 1) : begin;
}

/**
 * The selected roles of a CSV file's columns as query parameters; `roles` has the role of each, undefined
 * before a selection.
 */
export function csvParameters(rate, roles) {
  if (!roles) return { sample_rate_hz: rate };
  const placesOf = (role) => roles.flatMap((other, place) => (other === role ? [place + 1] : []));
  const [times, columns] = [placesOf("time"), placesOf("channel").join(",")];
  // The service finds hour, minute, second and microsecond columns
  return { sample_rate_hz: rate, time_column: times.length > 1 ? undefined : (times[0] ?? 0), columns };
}

const NO_RATE = "there is no time column: enter the sampling rate above";
const RATE_SOURCES = { given: () => "entered", header: () => "a line before the header" };

/**
 * A CSV file with the given column roles; errors are in `fault`, beside the columns if these could be read.
 */
async function ofCsv(file, rate, roles) {
  const seen = await previewCsv(await firstLines(file), csvParameters(rate, roles));
  const whole = file.size <= CSV_BEGIN;
  const time = seen.columns.findIndex(({ role }) => role === "time");
  const channels = seen.columns
    .map((column, place) => ({ ...column, place }))
    .filter(({ role }) => role === "channel")
    .map(({ place, name, unit, envelope }) => ({
      place,
      name,
      unit: unit ?? "",
      sketch: envelope.length ? { columns: envelope, whole } : null,
    }));
  const share = whole ? 1 : file.size / CSV_BEGIN;
  const times = () => `column “${seen.columns[time]?.label}”`;
  return {
    columns: seen.columns.map(({ label }) => label),
    roles: seen.columns.map(({ role }) => role),
    channels: seen.fault ? [] : channels,
    rate: seen.sample_rate_hz,
    seconds: seen.sample_rate_hz ? (seen.lines * share) / seen.sample_rate_hz : null,
    isEstimate: !whole,
    form: "CSV",
    rateFrom: seen.rate_source && (RATE_SOURCES[seen.rate_source] ?? times)(),
    begins: seen.start_time,
    lacksRate: !seen.fault && !seen.sample_rate_hz,
    fault: seen.fault?.replace(/^csv /, "") ?? (seen.sample_rate_hz ? null : NO_RATE),
  };
}

/** The channels of a recording previewed by the service. */
function seenChannels({ channels }, whole) {
  return channels.map(({ channel, unit, envelope, start_time: start }) => ({
    name: channel,
    start,
    unit: unit ?? "",
    sketch: envelope.length ? { columns: envelope, whole } : null,
  }));
}

async function ofMcap(file) {
  const summary = await mcapSummary(file);
  const seen = await previewRecording(file.slice(0, MCAP_BEGIN), "application/mcap", {});
  const [first] = seen.channels;
  return {
    channels: seenChannels(seen, false),
    summary,
    form: "MCAP",
    rate: first?.sample_rate_hz,
    words: summary ? null : "no summary at the end of the file; the service reads all of it",
    // The start of a longer file may break off before the first record ends
    fault: file.size <= MCAP_BEGIN ? seen.fault?.replace(/^mcap: /, "") : null,
    note: first ? `records of ${number(first.samples / first.sample_rate_hz, 3)} s` : null,
  };
}

const LARGE = "too large for a preview";
const NAMES = { flac: "FLAC", mat: "MATLAB", npy: "NumPy" };

/** A MATLAB, NumPy or FLAC file; the first two with the entered sampling rate, if any. */
async function ofSamples(file, rate) {
  const ending = endingOf(file);
  const form = NAMES[ending];
  if (file.size > MAX_RECORDING) return { channels: [], form, note: LARGE };
  const given = ending === "flac" ? {} : { sample_rate_hz: rate };
  const seen = await previewRecording(file, TYPES[ending], given);
  const [first] = seen.channels;
  return {
    channels: seenChannels(seen, true),
    form,
    rate: first?.sample_rate_hz,
    rateFrom: given.sample_rate_hz ? "entered" : "from the file",
    seconds: first && first.samples / first.sample_rate_hz,
    lacksRate: ending !== "flac" && !first && !rate,
    fault: seen.fault,
  };
}

async function ofBlock(file) {
  if (file.size > MAX_RECORDING) return { channels: [], form: "protobuf", note: LARGE };
  const seen = await previewRecording(file, "application/x-protobuf", {});
  const [first] = seen.channels;
  return {
    channels: seenChannels(seen, true),
    form: "protobuf",
    rate: first?.sample_rate_hz,
    seconds: first && first.samples / first.sample_rate_hz,
    ownStart: first?.start_time,
    fault: seen.fault,
  };
}

async function ofJson(file) {
  if (file.size > MAX_JSON) return { channels: [], form: "JSON", words: "too large for a preview" };
  const {
    start_time: start,
    sample_rate_hz: rate,
    unit = "",
    channel = "",
    samples,
  } = JSON.parse(await file.text());
  if (!Array.isArray(samples)) return { channels: [], form: "JSON", fault: "it contains no samples" };
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
  "audio/flac": ofSamples,
  "application/x-matlab-data": ofSamples,
  "application/x-npy": ofSamples,
  "application/x-protobuf": ofBlock,
};

/**
 * What is known of a file before the upload; `fault` is what is wrong with it, `lacksRate` whether a sampling
 * rate may mend it. Never throws.
 */
export async function preview(file, rate, roles) {
  const type = typeOf(file);
  if (!type)
    return {
      type,
      channels: [],
      fault: `expected a file of ${ENDINGS.slice(0, -1).join(", ")} or ${ENDINGS.at(-1)}`,
    };
  const start = (startTime) => (OWN_TIMES.includes(type) ? null : startOfFile(file, startTime));
  try {
    const seen = await READERS[type](file, rate, roles);
    return { type, start: start(seen.begins), ...seen };
  } catch (error) {
    return { type, start: start(null), channels: [], fault: error.message };
  }
}
