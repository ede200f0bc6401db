// How high an amplitude is drawn: as it is, over a logarithmic axis, or in decibels.

import { titled, unit } from "./format.js";

/** Of a level in dB: 1 µm/s², 1 nm/s and 1 pm (ISO 1683), each in the unit that is shown. */
const REFERENCE = 1e-6;

/** The scales by what an address calls them. */
export const SCALES = [
  ["", "Linear"],
  ["log", "Logarithmic"],
  ["db", "dB"],
  ["change", "dB to the first record"],
];

/** An amplitude in decibels above the reference; null of nothing. */
export function level(amplitude) {
  return amplitude > 0 ? 20 * Math.log10(amplitude / REFERENCE) : null;
}

/** What 0 dB is. */
export function referenceWords(unitName) {
  return `0 dB is 10⁻⁶ ${unit(unitName)}`.trim();
}

/** An amplitude as the scale draws it. */
export function height(scale, amplitude) {
  return scale === "db" ? level(amplitude) : amplitude;
}

/** The place of an amplitude for what Plotly takes in the axis's own numbers, such as a label. */
export function place(scale, amplitude) {
  return scale === "log" ? Math.log10(amplitude) : height(scale, amplitude);
}

const ROOM = { linear: 1.15, log: 3, db: 8 }; // above the highest peak, for labels

/** The axis of amplitudes, of which `visible` are in sight; over a log scale and in dB from below the median, so that noise stays in sight. */
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
