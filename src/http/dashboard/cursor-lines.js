// A cursor over a spectrum as an address has it, and the lines that belong to it.

const MOST_HARMONICS = 30;
const SIDEBANDS = 5;

/** A cursor of an address: `h~399.4`, or `s~399.4~16.64`; null for none. */
export function parseCursor(text) {
  const [kind, first, second] = (text ?? "").split("~");
  const [base, spacing] = [Number(first), Number(second)];
  if (kind === "h" && base > 0) return { kind, base };
  return kind === "s" && base > 0 && spacing > 0 ? { kind, base, spacing } : null;
}

/**
 * The cursor as an address has it.
 * @param {{ kind: string, base: number, spacing?: number }} cursor
 */
export function formatCursor({ kind, base, spacing }) {
  return [kind, base, spacing]
    .filter((part) => part !== undefined)
    .map((part) => (typeof part === "number" ? Number(part.toPrecision(7)) : part))
    .join("~");
}

/** Its lines up to the spectrum's `end`: `x` in the unit of the axis and a `label`. */
export function cursorLines({ kind, base, spacing }, end) {
  if (kind === "h")
    return Array.from({ length: Math.min(MOST_HARMONICS, Math.floor(end / base)) }, (_, n) => ({
      x: (n + 1) * base,
      label: `${n + 1}×`,
    }));
  const offsets = Array.from({ length: 2 * SIDEBANDS + 1 }, (_, n) => n - SIDEBANDS);
  return offsets
    .map((k) => ({ x: base + k * spacing, label: k === 0 ? "0" : `${k > 0 ? "+" : "−"}${Math.abs(k)}` }))
    .filter(({ x }) => x > 0 && x <= end);
}

/**
 * `[from, to]` of what a cursor reads, with room for a line more and in large steps, so that a cursor that is moved a little reads the same.
 * @param {{ kind: string, base: number, spacing?: number }} cursor
 * @param {number} end
 */
export function cursorReach({ kind, base, spacing }, end) {
  const upwards = (reach) => 2 ** Math.ceil(Math.log2(reach));
  if (kind === "h") return [0, Math.min(end, upwards((MOST_HARMONICS + 1) * base))];
  const reach = (SIDEBANDS + 1) * spacing;
  const step = upwards(reach);
  return [
    Math.max(0, Math.floor((base - reach) / step) * step),
    Math.min(end, Math.ceil((base + reach) / step) * step),
  ];
}
