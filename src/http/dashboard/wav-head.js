// The header of a WAV file and a thumbnail of its samples, read in slices: a file may exceed the page's
// memory.

const UNKNOWN_LENGTH = 0xffffffff; // of a stream
const CHUNKS = 64; // searched for the samples
const EXTENSIBLE = 0xfffe;
const COLUMNS = 240; // of a thumbnail
const WHOLE_BYTES = 4 * 1024 * 1024; // up to this size every sample is read
const PIECE_BYTES = 4096; // of a larger file, read at each column

const FORMATS = {
  "1/8": [1, (view, at) => (view.getUint8(at) - 128) / 128],
  "1/16": [2, (view, at) => view.getInt16(at, true) / 32768],
  "1/24": [
    3,
    (view, at) => (view.getUint8(at) | (view.getUint8(at + 1) << 8) | (view.getInt8(at + 2) << 16)) / 8388608,
  ],
  "1/32": [4, (view, at) => view.getInt32(at, true) / 2147483648],
  "3/32": [4, (view, at) => view.getFloat32(at, true)],
  "3/64": [8, (view, at) => view.getFloat64(at, true)],
};

/** A slice of a file. */
export const view = async (file, from, to) => new DataView(await file.slice(from, to).arrayBuffer());
const tag = (data, at) => String.fromCharCode(...Array.from({ length: 4 }, (_, n) => data.getUint8(at + n)));

/**
 * `{ format, bits, channels, rate, at, bytes, frames, frameBytes, lost }` of a WAV file; `at` is the offset of
 * its samples, `lost` the number of declared bytes that the file does not have.
 */
export async function wavHead(file) {
  const begin = await view(file, 0, 12);
  if (begin.byteLength < 12 || tag(begin, 0) !== "RIFF" || tag(begin, 8) !== "WAVE")
    throw new Error("it does not start like a WAV file (RIFF, WAVE)");
  let form = null;
  for (let at = 12, n = 0; n < CHUNKS && at + 8 <= file.size; n++) {
    const head = await view(file, at, at + 48);
    const [name, size] = [tag(head, 0), head.getUint32(4, true)];
    if (name === "fmt ") {
      if (size < 16 || head.byteLength < 24)
        throw new Error(`its format chunk has ${size} bytes, expected at least 16`);
      const kind = head.getUint16(8, true);
      form = {
        format: kind === EXTENSIBLE && size >= 26 && head.byteLength >= 34 ? head.getUint16(32, true) : kind,
        channels: head.getUint16(10, true),
        rate: head.getUint32(12, true),
        frameBytes: head.getUint16(20, true),
        bits: head.getUint16(22, true),
      };
    }
    if (name === "data") {
      if (!form) throw new Error("the data chunk precedes the format chunk");
      const bytes = Math.min(size, file.size - at - 8);
      if (!form.frameBytes || !form.channels || !form.rate)
        throw new Error("its format chunk has no rate or channels");
      const lost = size === UNKNOWN_LENGTH ? 0 : size - bytes;
      return { ...form, at: at + 8, bytes, frames: Math.floor(bytes / form.frameBytes), lost };
    }
    at += 8 + size + (size % 2);
  }
  throw new Error(form ? "it has no data chunk" : "it has no format chunk");
}

/** The minimum and maximum of `values` in up to `COLUMNS` intervals: `[low, high]` each. */
export function envelopeOf(values) {
  const columns = Math.min(COLUMNS, values.length);
  return Array.from({ length: columns }, (_, column) => {
    let [low, high] = [Infinity, -Infinity];
    for (
      let n = Math.floor((column * values.length) / columns);
      n < Math.floor(((column + 1) * values.length) / columns);
      n++
    ) {
      if (values[n] < low) low = values[n];
      if (values[n] > high) high = values[n];
    }
    return [low, high];
  });
}

function samplesOf(data, head, read, size, channel) {
  const frames = Math.floor(data.byteLength / head.frameBytes);
  return Float64Array.from({ length: frames }, (_, n) => read(data, n * head.frameBytes + channel * size));
}

/**
 * A thumbnail of a channel: `{ columns, whole }`; a large file is sampled at each column. Null when its
 * samples cannot be read here.
 */
export async function wavSketch(file, head, channel) {
  const [size, read] = FORMATS[`${head.format}/${head.bits}`] ?? [];
  if (!size || head.frames === 0 || head.frameBytes < size * head.channels) return null;
  if (head.bytes <= WHOLE_BYTES)
    return {
      columns: envelopeOf(
        samplesOf(await view(file, head.at, head.at + head.bytes), head, read, size, channel),
      ),
      whole: true,
    };
  const piece = Math.max(1, Math.floor(PIECE_BYTES / head.frameBytes));
  const columns = [];
  for (let column = 0; column < COLUMNS; column++) {
    const from = head.at + Math.floor((column * (head.frames - piece)) / (COLUMNS - 1)) * head.frameBytes;
    columns.push(
      envelopeOf(
        samplesOf(await view(file, from, from + piece * head.frameBytes), head, read, size, channel),
      ).reduce(([low, high], [l, h]) => [Math.min(low, l), Math.max(high, h)]),
    );
  }
  return { columns, whole: false };
}
