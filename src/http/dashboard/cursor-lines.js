// Spectrum cursors: parsing and formatting for addresses, and the lines that belong to a cursor.

import { BEARING_LINES, parseBearing } from "./bearing-geometry.js";

const MAX_HARMONICS = 30;
const SIDEBANDS = 5;
const BEARING_HARMONICS = 3;

/** @typedef {{ kind: string, base: number, spacing?: number, orders?: Record<string, number>, name?: string }} Cursor */

/**
 * Parses a cursor of an address: `h~399.4`, or `s~399.4~16.64`; null for none.
 * @returns {Cursor | null}
 */
function parseCursor(text) {
  const [kind, first, second] = (text ?? "").split("~");
  const [base, spacing] = [Number(first), Number(second)];
  if (kind === "h" && base > 0) return { kind, base };
  return kind === "s" && base > 0 && spacing > 0 ? { kind, base, spacing } : null;
}

/**
 * The cursor `query[parameter]` over a spectrum. Besides the forms of `parseCursor`, `b` marks the lines of
 * the bearing named in the address, at the speed given there in Hz or else at the record's speed. Null for
 * none.
 */
export function cursorOf(query, spectrum, parameter = "cursor") {
  if (query[parameter] !== "b") return parseCursor(query[parameter]);
  const bearing = parseBearing(query.bearing);
  // Over orders, a speed in Hz counts only where the speed of the record is known
  const hertz = spectrum.hertz_per_unit ?? (spectrum.axis ? NaN : 1);
  const speed = Number(query.speed) / hertz;
  const base = speed > 0 ? speed : spectrum.shaft_speed_hz;
  return bearing && base ? { kind: "b", base, orders: bearing.orders, name: bearing.name } : null;
}

/**
 * Formats a cursor for an address.
 * @param {{ kind: string, base: number, spacing?: number }} cursor
 */
export function formatCursor({ kind, base, spacing }) {
  return [kind, base, spacing]
    .filter((part) => part !== undefined)
    .map((part) => (typeof part === "number" ? Number(part.toPrecision(7)) : part))
    .join("~");
}

/** The lines of a bearing and their harmonics. */
function bearingLines(base, orders) {
  return BEARING_LINES.flatMap(([key, name]) =>
    Array.from({ length: BEARING_HARMONICS }, (_, n) => ({
      x: (n + 1) * orders[key] * base,
      label: n ? `${n + 1}×${name}` : name,
    })),
  );
}

/**
 * The cursor's lines up to `end` of the spectrum: `x` in the unit of the axis, and a `label`.
 * @param {Cursor} cursor
 * @param {number} end
 */
export function cursorLines({ kind, base, spacing, orders }, end) {
  if (kind === "b") return bearingLines(base, orders).filter(({ x }) => x <= end);
  if (kind === "h")
    return Array.from({ length: Math.min(MAX_HARMONICS, Math.floor(end / base)) }, (_, n) => ({
      x: (n + 1) * base,
      label: `${n + 1}×`,
    }));
  const offsets = Array.from({ length: 2 * SIDEBANDS + 1 }, (_, n) => n - SIDEBANDS);
  return offsets
    .map((k) => ({ x: base + k * spacing, label: k === 0 ? "0" : `${k > 0 ? "+" : "−"}${Math.abs(k)}` }))
    .filter(({ x }) => x > 0 && x <= end);
}

/**
 * The distance of the cursor's lines; undefined for those of a bearing.
 * @param {Cursor} cursor
 */
export const spacingOf = ({ kind, base, spacing }) => (kind === "b" ? undefined : (spacing ?? base));

/**
 * The range `[from, to]` that a cursor reads, plus one line and rounded to large steps, so that a small move
 * needs no new data.
 * @param {Cursor} cursor
 * @param {number} end
 */
export function cursorReach({ kind, base, spacing, orders }, end) {
  const upwards = (reach) => 2 ** Math.ceil(Math.log2(reach));
  if (kind === "b")
    return [0, Math.min(end, upwards((BEARING_HARMONICS + 1) * base * Math.max(...Object.values(orders))))];
  if (kind === "h") return [0, Math.min(end, upwards((MAX_HARMONICS + 1) * base))];
  const reach = (SIDEBANDS + 1) * spacing;
  const step = upwards(reach);
  return [
    Math.max(0, Math.floor((base - reach) / step) * step),
    Math.min(end, Math.ceil((base + reach) / step) * step),
  ];
}
