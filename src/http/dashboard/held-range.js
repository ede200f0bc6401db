// The range of an axis that stays while it fits: values that come several times a second would make it jump.

const ROOM = 0.15;
const TOO_WIDE = 0.35; // less than this part of the range in use
const SHRINK_MS = 3000;

/** A range that grows at once and shrinks after a while. */
export class HeldRange {
  #range = null;
  #fittedAt = 0;

  /** The range to show values from `low` to `high` in, and whether `low` is an end that needs no room. */
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

  /** Forgets it, for another unit or another channel. */
  forget() {
    this.#range = null;
  }
}
