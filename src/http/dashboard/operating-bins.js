// Separates records by operating point: a trend within one bin is clearer than one over all.

import { number } from "./format.js";

const MAX_BINS = 4;
const MIN_SPREAD = 0.01; // relative spread below which all records count as equal
const QUANTITIES = {
  speed: {
    name: "shaft speed",
    unit: "rpm",
    of: ({ shaft_speed: speed }) => speed && 60 * speed.shaft_speed_hz,
  },
  torque: { name: "torque", unit: "N·m", of: (segment) => segment.operating_point?.torque_nm },
};

/**
 * Equal-width bins over the latest records' speed or torque: `{ words, bins, of }` with the bin of each
 * record id; null without a choice.
 */
export function operatingBins(segments, choice) {
  const quantity = QUANTITIES[choice];
  if (!quantity || !segments || segments instanceof Error) return null;
  const known = segments.items
    .map((segment) => [segment.id, quantity.of(segment)])
    .filter(([, value]) => value != null);
  if (known.length === 0) return { bins: [], of: new Map(), words: `No record has a ${quantity.name}.` };
  const values = known.map(([, value]) => value);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const alike = high - low < MIN_SPREAD * Math.abs(high);
  const count = alike ? 1 : MAX_BINS;
  const width = (high - low) / count || 1;
  const bins = Array.from(
    { length: count },
    (_, n) =>
      `${number(low + n * width, 4)} to ${number(alike ? high : low + (n + 1) * width, 4)} ${quantity.unit}`,
  );
  const of = new Map(
    known.map(([id, value]) => [id, Math.min(count - 1, Math.floor((value - low) / width))]),
  );
  const latest = segments.next_cursor ? ` of the latest ${segments.items.length} records` : "";
  return {
    bins,
    of,
    words: alike
      ? `The ${quantity.name}${latest} is constant within 1 %.`
      : `Coloured by ${quantity.name}${latest}.`,
  };
}

/** The asset's own bins, named in each row of a trend, in the form of `operatingBins`. */
export function namedBins(trend, own) {
  if (!trend || trend instanceof Error) return null;
  const names = own.map(({ name }) => name);
  const of = new Map(
    trend.items
      .filter(({ operating_bin: name }) => names.includes(name))
      .map(({ segment_id: id, operating_bin: name }) => [id, names.indexOf(name)]),
  );
  return { bins: names, of, words: "Coloured by operating bin; grey: in none." };
}

/** One trace per bin, and one of records without an operating point. */
export function binTraces(items, name, { bins, of }, colour) {
  const trace = (wanted, stroke) => {
    const some = items.filter((item) => (of.get(item.segment_id) ?? -1) === wanted);
    return {
      x: some.map((item) => item.start_time),
      y: some.map((item) => item[name]),
      mode: "markers",
      marker: { size: 4.5, color: stroke },
      hoverinfo: "skip",
    };
  };
  return [trace(-1, colour.edge), ...bins.map((_, n) => trace(n, binColour(n, colour)))];
}

// The fifth series colour is the grey of records in no bin
const binColour = (n, colour) =>
  [...colour.series.slice(0, 4), colour.reference, colour.danger, colour.warning, colour.ink][n % 8];

/** Legend of the colours. */
export function binEntries({ bins }, colour) {
  return bins.map((words, n) => ["band", binColour(n, colour), words]);
}
