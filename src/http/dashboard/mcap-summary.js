// The summary at the end of an MCAP file: topics with message counts, and the time range. Nothing else is
// read.

import { view } from "./wav-head.js";

const MAGIC = [0x89, 0x4d, 0x43, 0x41, 0x50, 0x30, 0x0d, 0x0a];
const FOOTER_BYTES = 9 + 20 + MAGIC.length;
const MAX_SUMMARY = 8 * 1024 * 1024;
const [CHANNEL, STATISTICS] = [0x04, 0x0b];

const isMagic = (data, at) => MAGIC.every((byte, n) => data.getUint8(at + n) === byte);

function text(data, at) {
  const length = data.getUint32(at, true);
  if (at + 4 + length > data.byteLength) throw new Error("a name in its summary is longer than the summary");
  return {
    value: new TextDecoder().decode(new Uint8Array(data.buffer, data.byteOffset + at + 4, length)),
    next: at + 4 + length,
  };
}

/**
 * `{ topics: [{ topic, messages }], messages, start, end }` with ISO times; null when the file has no
 * summary.
 */
export async function mcapSummary(file) {
  if (file.size < MAGIC.length + FOOTER_BYTES)
    throw new Error(`it has ${file.size} bytes, too short for an MCAP file`);
  const begin = await view(file, 0, MAGIC.length);
  if (!isMagic(begin, 0)) throw new Error("it does not start like an MCAP file");
  const end = await view(file, file.size - FOOTER_BYTES, file.size);
  if (!isMagic(end, FOOTER_BYTES - MAGIC.length) || end.getUint8(0) !== 0x02)
    throw new Error("it is truncated");
  const start = Number(end.getBigUint64(9, true));
  const size = file.size - FOOTER_BYTES - start;
  if (start === 0 || size <= 0 || size > MAX_SUMMARY) return null;
  return read(await view(file, start, start + size));
}

function read(data) {
  const topics = new Map();
  let statistics = null;
  for (let at = 0; at + 9 <= data.byteLength;) {
    const [kind, size] = [data.getUint8(at), Number(data.getBigUint64(at + 1, true))];
    const from = at + 9;
    if (from + size > data.byteLength) break;
    const record = new DataView(data.buffer, data.byteOffset + from, size);
    if (kind === CHANNEL && size >= 8) topics.set(record.getUint16(0, true), text(record, 4).value);
    if (kind === STATISTICS && size >= 46) statistics = record;
    at = from + size;
  }
  if (!statistics) return null;
  const counts = new Map();
  for (let at = 46; at + 10 <= statistics.byteLength; at += 10)
    counts.set(statistics.getUint16(at, true), Number(statistics.getBigUint64(at + 2, true)));
  const time = (at) => new Date(Number(statistics.getBigUint64(at, true) / 1_000_000n)).toISOString();
  const messages = Number(statistics.getBigUint64(0, true));
  return {
    topics: [...topics].map(([id, topic]) => ({ topic, messages: counts.get(id) ?? 0 })),
    messages,
    start: messages ? time(26) : null,
    end: messages ? time(34) : null,
  };
}
