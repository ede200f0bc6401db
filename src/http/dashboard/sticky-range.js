// An axis range that stays while it fits: values arriving several times a second would otherwise make it
// jump.

const ROOM = 0.15;
const TOO_WIDE = 0.35; // fraction of the range in use below which it shrinks
const SHRINK_MS = 3000;

/** A range that grows at once and shrinks after a while. */
export class StickyRange {
  #range = null;
  #fittedAt = 0;

  /** The range that shows values from `low` to `high`; whether `low` is a fixed end that needs no margin. */
  fit(low, high, { isFloor = false } = {}, now = Date.now()) {
    if (!Number.isFinite(low) || !Number.isFinite(high)) return this.#range ?? [0, 1];
    const span = high - low || Math.abs(high) || 1;
    const [from, to] = this.#range ?? [];
    const fits = this.#range && low >= from && high <= to;
    if (fits && span > TOO_WIDE * (to - from)) this.#fittedAt = now;
    if (!fits || now - this.#fittedAt > SHRINK_MS) {
      this.#range = [isFloor ? low : low - ROOM * span, high + ROOM * span];
      this.#fittedAt = now;
    }
    return this.#range;
  }

  /** Forgets the range, for another unit or channel. */
  forget() {
    this.#range = null;
  }
}
