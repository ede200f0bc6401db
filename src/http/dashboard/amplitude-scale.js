// Amplitude scales: linear, logarithmic, or decibels.

import { titled, unit } from "./format.js";

/** Reference of levels in dB: 1 µm/s², 1 nm/s and 1 pm (ISO 1683), each in the displayed unit. */
const REFERENCE = 1e-6;

/** The scales by their name in an address. */
export const SCALES = [
  ["", "Linear"],
  ["log", "Logarithmic"],
  ["db", "dB"],
  ["change", "dB re first record"],
];

/** An amplitude in dB above the reference; null for a missing or zero amplitude. */
export function level(amplitude) {
  return amplitude > 0 ? 20 * Math.log10(amplitude / REFERENCE) : null;
}

/** Describes the 0 dB reference. */
export function referenceWords(unitName) {
  return `0 dB is 10⁻⁶ ${unit(unitName)}`.trim();
}

/** An amplitude as drawn on the scale. */
export function height(scale, amplitude) {
  return scale === "db" ? level(amplitude) : amplitude;
}

/** An amplitude in the axis's own coordinates, as Plotly expects for labels. */
export function place(scale, amplitude) {
  return scale === "log" ? Math.log10(amplitude) : height(scale, amplitude);
}

const ROOM = { linear: 1.15, log: 3, db: 8 }; // above the highest peak, for labels

/**
 * The amplitude axis for the `visible` amplitudes. On logarithmic and dB scales it starts below the median,
 * so that noise stays visible.
 */
export function amplitudeAxis(scale, title, unitName, visible, revision) {
  const sorted = visible.filter((amplitude) => amplitude > 0).sort((a, b) => a - b);
  const top = sorted.at(-1) || 1;
  const uirevision = `${revision} ${scale}`;
  if (!scale)
    return {
      title: { text: titled(title, unitName) },
      type: "linear",
      range: [0, ROOM.linear * top],
      uirevision,
    };
  const low = Math.max((sorted[sorted.length >> 1] ?? top) / 5, top * 1e-8);
  if (scale === "db")
    return {
      title: { text: `${title} (dB re 10⁻⁶ ${unit(unitName)})` },
      type: "linear",
      range: [level(low), level(top) + ROOM.db],
      uirevision,
    };
  return {
    title: { text: titled(title, unitName) },
    type: "log",
    range: [Math.log10(low), Math.log10(ROOM.log * top)],
    dtick: 1,
    exponentformat: "power",
    uirevision,
  };
}
