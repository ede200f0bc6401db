// Vibration as acceleration, velocity or displacement: lines divided by the angular frequency once or twice,
// down to a cut-off, below which the division would raise the noise above everything else. Spectra are
// divided here, waveforms by the service.

import { mapLines } from "./fine-lines.js";
import { number, unit } from "./format.js";

/** Units of samples: how often displacement is differentiated, and how much one of it is in SI units. */
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

/** What can be shown, by what an address calls it. */
export const QUANTITIES = {
  acceleration: { label: "Acceleration", unit: "m/s2", order: 2, si: 1 },
  velocity: { label: "Velocity", unit: "mm/s", order: 1, si: 1e-3 },
  displacement: { label: "Displacement", unit: "µm", order: 0, si: 1e-6 },
};

/** Cut-offs in hertz that can be chosen. */
export const CUT_OFFS = [1, 2, 5, 10, 20];
const CUT_OFF = 10; // as ISO 20816 takes velocity

/** The quantity and the cut-off of an address. */
export function quantityOf({ quantity, cut }) {
  const key = quantity in QUANTITIES ? quantity : "acceleration";
  return { key, ...QUANTITIES[key], cut_hz: Number(cut) > 0 ? Number(cut) : CUT_OFF };
}

/** Whether samples of a unit can be shown as another quantity. */
export const isConvertible = (unitName) => unitName in UNITS;

/** What a waveform in a unit is asked with to come as the quantity of an address. */
export function motionOf(query, unitName) {
  const { key, cut_hz } = quantityOf(query);
  return isConvertible(unitName) ? { quantity: key, cut_hz } : {};
}

/**
 * A spectrum as a quantity; lines below the cut-off are null where it is divided. `hertz` is what one of its axis stands for. A spectrum in another unit than
 * those of motion stays as it is.
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

/** What was done to the lines, in words; empty where nothing was. */
export function conversionWords(units, { label, order, unit: shown, cut_hz: cut }) {
  const foreign = units.filter((name) => !isConvertible(name));
  const divided = units.some((name) => isConvertible(name) && UNITS[name][0] > order);
  const times = Math.max(...units.map((name) => UNITS[name]?.[0] ?? 0)) - order;
  const words = divided
    ? ` ${label} in ${unit(shown)}: each line divided by ${times > 1 ? "(2πf)²" : "2πf"}, from ${number(cut)} Hz.`
    : "";
  return foreign.length
    ? `${words} Records in ${[...new Set(foreign)].map((name) => unit(name) || "no unit").join(", ")} are shown as they came.`
    : words;
}
