// The lines of a spectrum at full resolution: those of the part that is looked at, and those that a cursor
// reads. The whole is drawn from fewer points, of which each stands for the greatest of many lines.

import { cursorReach, parseCursor } from "./cursor-lines.js";

const MOST = 200_000; // lines that the server gives at once
const MOST_DRAWN = 20_000; // more than any screen has columns
const MARGIN = 0.1; // of a part, to either side: a pinned record runs at a speed of its own

/** Lines that stand `step` apart without a gap, the first of them at `first` steps. */
class FineLines {
  constructor(step, first, amplitude) {
    this.step = step;
    this.first = first;
    this.amplitude = amplitude;
  }

  static of({ resolution_hz: step, frequency_hz: x, amplitude }) {
    return new FineLines(step, Math.round((x[0] ?? 0) / step), amplitude);
  }

  /** Place of the greatest line within `reach` lines of a frequency; -1 where that lies outside. */
  #greatest(frequency, reach) {
    const nearest = Math.round(frequency / this.step) - this.first;
    if (!(nearest >= 0 && nearest < this.amplitude.length)) return -1;
    let best = nearest;
    for (let n = Math.max(0, nearest - reach); n <= nearest + reach; n++)
      if (this.amplitude[n] > this.amplitude[best]) best = n;
    return best;
  }

  /** The amplitude at a frequency: the greatest of the nearest three lines, as a tone may fall between two; undefined outside. */
  at(frequency) {
    return this.amplitude[this.#greatest(frequency, 1)];
  }

  /** The frequency of the greatest line within `reach` lines; undefined outside. */
  peakNear(frequency, reach) {
    const best = this.#greatest(frequency, reach);
    return best < 0 ? undefined : (this.first + best) * this.step;
  }
}

/** The amplitude at a frequency at full resolution; undefined where those lines are not known. */
export function amplitudeAt({ fine }, frequency) {
  return fine.map((lines) => lines.at(frequency)).find((amplitude) => amplitude !== undefined);
}

/** The frequency of the peak within `reach` lines; undefined where those lines are not known. */
export function peakNear({ fine }, frequency, reach) {
  return fine.map((lines) => lines.peakNear(frequency, reach)).find((peak) => peak !== undefined);
}

/** Every line from one frequency to another; `ask(from, to, points)` asks the server for some of them. */
async function linesOf(ask, step, [from, to]) {
  const [first, last] = [Math.max(0, Math.floor(from / step)), Math.ceil(to / step)];
  const amplitude = [];
  for (let low = first; low <= last; low += MOST) {
    const high = Math.min(last, low + MOST - 1);
    // half a line more, so that rounding takes none away
    const part = await ask(Math.max(0, (low - 0.5) * step), (high + 0.5) * step, MOST);
    amplitude.push(part.amplitude);
    if (part.amplitude.length < high - low + 1) break; // the spectrum ends here
  }
  return new FineLines(step, first, amplitude.flat());
}

/** The points of the whole with those of a part in their place. */
function spliced({ frequency_hz: x, amplitude: y }, part) {
  const { frequency_hz: inner, amplitude } = part;
  if (inner.length === 0) return {};
  const before = x.findIndex((value) => value >= inner[0]);
  const after = x.findIndex((value) => value > inner.at(-1));
  const [head, tail] = [before < 0 ? x.length : before, after < 0 ? x.length : after];
  return {
    frequency_hz: [...x.slice(0, head), ...inner, ...x.slice(tail)],
    amplitude: [...y.slice(0, head), ...amplitude, ...y.slice(tail)],
  };
}

/**
 * A spectrum with its `fine` lines: those of the `part` that is looked at, which is drawn from them, and those `read` besides. `part` and
 * `read` are `[from, to]` or null; `ask(from, to, points)` asks the server.
 */
export async function withFineLines(spectrum, part, read, ask) {
  if (!spectrum.reduced || spectrum.frequency_hz.length === 0)
    return { ...spectrum, fine: [FineLines.of(spectrum)] };
  const { resolution_hz: step } = spectrum;
  const fine = read ? [await linesOf(ask, step, read)] : [];
  if (!part) return { ...spectrum, fine };
  const margin = MARGIN * (part[1] - part[0]);
  const shown = await ask(Math.max(0, part[0] - margin), part[1] + margin, MOST_DRAWN);
  if (!shown.reduced) fine.push(FineLines.of(shown));
  return { ...spectrum, ...spliced(spectrum, shown), fine, part: shown };
}

/** The frequencies that the cursor of an address reads; null without one. */
export function readByCursor(text, spectrum) {
  const cursor = parseCursor(text);
  return cursor && cursorReach(cursor, spectrum.frequency_hz.at(-1));
}
