// Converts vibration between acceleration, velocity and displacement: lines are divided by the angular
// frequency once or twice above a cut-off, below which the division would amplify noise. Spectra are
// converted here, waveforms by the service.

import { mapLines } from "./fine-lines.js";
import { number, unit } from "./format.js";

/** Units of samples: the number of differentiations from displacement, and the SI factor. */
const UNITS = {
  "m/s2": [2, 1],
  "m/s^2": [2, 1],
  "m/s²": [2, 1],
  "mm/s2": [2, 1e-3],
  g: [2, 9.80665],
  "m/s": [1, 1],
  "mm/s": [1, 1e-3],
  "in/s": [1, 0.0254],
  m: [0, 1],
  mm: [0, 1e-3],
  um: [0, 1e-6],
  µm: [0, 1e-6],
};

/** The selectable quantities by their name in an address. */
export const QUANTITIES = {
  acceleration: { label: "Acceleration", unit: "m/s2", order: 2, si: 1 },
  velocity: { label: "Velocity", unit: "mm/s", order: 1, si: 1e-3 },
  displacement: { label: "Displacement", unit: "µm", order: 0, si: 1e-6 },
};

/** The selectable cut-off frequencies in hertz. */
export const CUT_OFFS = [1, 2, 5, 10, 20];
const CUT_OFF = 10; // as ISO 20816 for velocity

/** The quantity and cut-off of an address. */
export function quantityOf({ quantity, cut }) {
  const key = quantity in QUANTITIES ? quantity : "acceleration";
  return { key, ...QUANTITIES[key], cut_hz: Number(cut) > 0 ? Number(cut) : CUT_OFF };
}

/** Whether samples of a unit can be converted to another quantity. */
const isConvertible = (unitName) => unitName in UNITS;

/** Request parameters that convert a waveform to the quantity of an address. */
export function motionOf(query, unitName) {
  const { key, cut_hz } = quantityOf(query);
  return isConvertible(unitName) ? { quantity: key, cut_hz } : {};
}

/**
 * Converts a spectrum to a quantity; where it is divided, lines below the cut-off are null. `hertz` is the
 * frequency of one axis unit. Spectra in other than motion units are unchanged.
 */
export function converted(spectrum, { order, si, unit: shown, cut_hz: cut }, hertz = 1) {
  if (!isConvertible(spectrum.unit)) return spectrum;
  const [own, ownSi] = UNITS[spectrum.unit];
  const power = order - own;
  const factor = ownSi / si;
  const lines = mapLines(spectrum, (x, amplitude) => {
    const frequency = hertz * x;
    if (power < 0 && frequency < cut) return null;
    return amplitude * factor * (2 * Math.PI * frequency) ** power;
  });
  return { ...lines, unit: shown };
}

/** Describes the conversion of the lines; empty when there was none. */
export function conversionWords(units, { label, order, unit: shown, cut_hz: cut }) {
  const foreign = units.filter((name) => !isConvertible(name));
  const divided = units.some((name) => isConvertible(name) && UNITS[name][0] > order);
  const times = Math.max(...units.map((name) => UNITS[name]?.[0] ?? 0)) - order;
  const words = divided
    ? ` ${label} in ${unit(shown)}: each line divided by ${times > 1 ? "(2πf)²" : "2πf"}, from ${number(cut)} Hz.`
    : "";
  return foreign.length
    ? `${words} Records in ${[...new Set(foreign)].map((name) => unit(name) || "no unit").join(", ")} are shown unconverted.`
    : words;
}
