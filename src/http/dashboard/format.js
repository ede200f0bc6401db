// Formats numbers, units and times for display. Times always name their time zone.

import { written, zoneOf } from "./time-zone.js";

const SUPERSCRIPTS = {
  "-": "⁻",
  0: "⁰",
  1: "¹",
  2: "²",
  3: "³",
  4: "⁴",
  5: "⁵",
  6: "⁶",
  7: "⁷",
  8: "⁸",
  9: "⁹",
};
const NONE = "–";

/** A number with `digits` significant digits; as a power of ten outside 0.001 … 100 000. */
export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const size = Math.abs(value);
  if (value !== 0 && (size < 1e-3 || size >= 1e5)) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    return `${Number(mantissa)} × 10${[...exponent.replace("+", "")].map((c) => SUPERSCRIPTS[c]).join("")}`;
  }
  return Number(value.toPrecision(digits)).toString();
}

/** A number of a table: with its trailing zeros, so that all have the same number of digits. */
export function figure(value, digits = 4) {
  const text = number(value, digits);
  const isPlain = /^-?[\d.]+$/.test(text) && value !== 0 && Math.abs(Number(text)) < 10 ** digits;
  return isPlain ? Number(value).toPrecision(digits) : text;
}

/** A number of a table with the same decimals in each row. */
export function decimals(value, places) {
  return Number.isFinite(value) ? value.toFixed(places) : NONE;
}

/** A change in decibels with its sign, without the unit. */
export function decibels(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const text = Math.abs(value).toFixed(1);
  return text === "0.0" ? "0.0" : `${value > 0 ? "+" : "−"}${text}`;
}

/** A number of things: "1 record", "2 records". */
export const some = (n, word) => `${count(n)} ${n === 1 ? word : `${word}s`}`;

/** The length of a recording. */
export function recordLength(seconds) {
  return seconds < 90 ? `${number(seconds, 3)} s` : `${number(seconds / 60, 3)} min`;
}

/** A wear depth in µm, without the unit; no decimals from 10 µm, where they would suggest false precision. */
export function depth(value) {
  if (value === null || value === undefined) return NONE;
  return value < 9.95 && value >= 0.05 ? value.toFixed(1) : value.toFixed(0);
}

/** A frequency with its unit. */
export function hertz(value) {
  if (value === null || value === undefined) return NONE;
  return value >= 10_000 ? `${number(value / 1000, 4)} kHz` : `${number(value, value >= 1000 ? 5 : 4)} Hz`;
}

/** A count with thin spaces between thousands. */
export function count(value) {
  return String(value).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** A unit as written on an axis: `m/s2` becomes m/s²; empty for a dimensionless value. */
export function unit(name) {
  if (!name || name === "1") return "";
  return name.replace(/(?<=[a-z)])\^?(-?\d)/gi, (_, power) =>
    [...power].map((c) => SUPERSCRIPTS[c]).join(""),
  );
}

/** A quantity's name with its unit as an axis title, or with a dash if dimensionless. */
export function titled(name, unitName) {
  const shown = unit(unitName);
  return shown ? `${name} (${shown})` : `${name} (–)`;
}

/**
 * `2026-03-02 14:05:09 UTC`, or `2026-03-02 15:05:09 +01:00` in the browser's time zone; optionally to the
 * minute.
 */
export function clock(time, { toMinute = false } = {}) {
  return time
    ? `${written(time)
        .slice(0, toMinute ? 16 : 19)
        .replace("T", " ")} ${zoneOf(time)}`
    : NONE;
}

/** A duration in its largest sensible unit. */
export function span(seconds) {
  const size = Math.abs(seconds);
  if (size < 90) return `${Math.round(size)} s`;
  if (size < 90 * 60) return `${Math.round(size / 60)} min`;
  if (size < 36 * 3600) return `${Math.round(size / 3600)} h`;
  if (size < 730 * 86400) return `${Math.round(size / 86400)} d`;
  return `${Math.round(size / (365.25 * 86400))} y`;
}

/** The age of a time relative to `now` (ms). */
export function age(time, now = Date.now()) {
  if (!time) return "never";
  const seconds = (now - Date.parse(time)) / 1000;
  if (seconds < -1.5) return `in ${span(seconds)}`;
  return seconds < 1.5 ? "just now" : `${span(seconds)} ago`;
}

/** A file size. */
export function bytes(value) {
  if (value < 1024) return `${value} B`;
  return value < 1024 * 1024 ? `${number(value / 1024, 3)} KiB` : `${number(value / 1024 / 1024, 3)} MiB`;
}

const INDICATORS = {
  rms: "RMS",
  kurtosis: "Kurtosis",
  velocity_rms: "Velocity RMS",
  omx: "OMX",
  omx_tracked: "OMX, order-tracked",
  crest_factor: "Crest factor",
  peak: "Peak",
  sideband_energy_ratio: "Sideband energy ratio",
  sideband_level_factor: "Sideband level factor",
  fm0: "FM0",
  fm4: "FM4",
  m6a: "M6A",
  m8a: "M8A",
  na4: "NA4",
  nb4: "NB4",
  novelty: "Novelty",
  wear_um: "Wear depth",
};

/** An indicator's display name. */
export function indicatorName(name) {
  const mesh = /^mesh_(\d+)$/.exec(name);
  if (mesh) return `Mesh harmonic ${mesh[1]}×`;
  const band = /^band_(.+)$/.exec(name);
  const [, bearing, line, ratio] = /^bearing_(.+)_(bpfo|bpfi|bsf|ftf)(_to_background)?$/.exec(name) ?? [];
  if (bearing) return `${line.toUpperCase()} of ${bearing}${ratio ? ", to background" : ""}`;
  return INDICATORS[name] ?? (band ? `Band ${band[1]}` : name.replaceAll("_", " "));
}

/** An octave by its centre frequency in Hz. */
function octaveWords(centre) {
  const edge = (hz) => hertz(Number(hz.toPrecision(2)));
  return `${edge(centre / Math.SQRT2)} to ${edge(centre * Math.SQRT2)}`;
}

const FEATURES = {
  ln_rms: "RMS",
  ln_kurtosis: "kurtosis",
  ln_tooth_worst: "single-tooth deviation",
  ln_tooth_repeated: "vibration synchronous with the shaft, without the mesh lines",
  ln_tooth_kurtosis: "kurtosis over one turn",
};

/** A feature's display name. */
export function featureName(name) {
  const [, kind, order] = /^ln_(mesh|sideband|env|shaft|floor|rest|band)_(\d+)(?:hz)?$/.exec(name) ?? [];
  const words = {
    mesh: () => `mesh ${order}×`,
    sideband: () => `sidebands of ${order}×`,
    env: () => `envelope of ${order}×`,
    shaft: () => `shaft ${order}×`,
    floor: () => `noise floor, ${octaveWords(Number(order))}`,
    rest: () => `vibration between the mesh lines, ${octaveWords(Number(order))}`,
    band: () => `vibration, ${octaveWords(Number(order))}`,
  }[kind];
  const [, tooth, turns] = /^(ln_tooth_[a-z]+)_(\d+)$/.exec(name) ?? [];
  if (tooth) return `${FEATURES[tooth]}, over ${turns} turns`;
  return words ? words() : (FEATURES[name] ?? name);
}

const ABSENCES = {
  no_speed: "no shaft speed",
  too_short: "record too short",
  constant: "constant signal",
  above_nyquist: "above half the sampling rate",
  too_few_turns: "fewer than 4 turns",
  speed_varies: "speed varies too much",
  clipped: "clipped",
  gaps: "missing samples",
  no_signal: "no reference signal",
  not_acceleration: "unit is neither acceleration nor velocity",
  above_envelope: "above the width of the envelope's band",
  other_mesh: "overlaps a line of another mesh",
  other_line: "overlaps a line of a shaft or of another part of a bearing",
};

/** Describes why an indicator of a record with this unit is missing. */
export function absence(reason, unitName) {
  if (reason === "not_acceleration" && !unit(unitName)) return "no unit given";
  return ABSENCES[reason] ?? reason.replaceAll("_", " ");
}

const SPEED_SOURCES = {
  record: "supplied with the record",
  tachometer: "from the tachometer",
  asset: "the asset's exact nominal speed",
  shaft_lines: "found from the shaft's own lines",
  nominal: "nominal, within its tolerance",
  mesh_comb: "detected from the mesh harmonics",
};

/** Describes the source of a shaft speed. */
export function speedSource(speed) {
  const words = SPEED_SOURCES[speed.source] ?? speed.source;
  const comb = speed.comb_to_background;
  const support = speed.harmonics_sought
    ? `, ${speed.harmonics_found} of ${speed.harmonics_sought} harmonics found`
    : "";
  return comb ? `${words}, ${number(comb, 2)} times the background${support}` : words;
}

/** A mesh frequency as teeth times a shaft speed, with a whole number of teeth if the speeds are close to one. */
function teethTimes(mesh, shaft) {
  const teeth = mesh / shaft;
  const whole = Math.round(teeth);
  return whole >= 1 && Math.abs(teeth - whole) <= 0.2
    ? `${whole} × ${hertz(mesh / whole)}`
    : `${number(teeth, 3)} × ${hertz(shaft)}`;
}

/** Why a shaft speed or tooth number may be wrong, with both interpretations, as a question; null without doubt. */
export function speedDoubt({
  doubt,
  shaft_speed_hz: shaft,
  mesh_frequency_hz: mesh,
  harmonics_found: found,
  harmonics_sought: sought,
}) {
  if (!doubt) return null;
  const described = `${Math.round(mesh / shaft)} × ${hertz(shaft)}`;
  const question = (evidence) => `uncertain: ${evidence}; are the tooth counts and the speed correct?`;
  if (doubt.reason === "other_mesh") {
    const { mesh_frequency_hz: other, teeth } = doubt;
    return question(
      teeth
        ? `the lines fit ${teeth} × ${hertz(other / teeth)} better than ${described}`
        : `the lines fit a mesh at ${hertz(other)} (${described.replace(/×.*/, "×")} ${hertz((other * shaft) / mesh)} or ${teethTimes(other, shaft)}) better than at ${hertz(mesh)} (${described})`,
    );
  }
  if (doubt.reason === "other_shaft") {
    const { shaft_speed_hz: other } = doubt;
    return question(`the shaft lines fit ${teethTimes(mesh, other)} better than ${described}`);
  }
  return question(`${found} of ${sought} mesh harmonics of ${described} found, at least 2 are needed`);
}
