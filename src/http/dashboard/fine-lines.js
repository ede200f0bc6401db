// Spectral lines at full resolution for the visible part and for cursors. The whole spectrum is drawn from
// fewer points, each the maximum of many lines.

import { cursorReach } from "./cursor-lines.js";

const MAX_LINES = 200_000; // lines that the server returns at once
const MAX_DRAWN = 20_000; // more than any screen has columns
const NOISE_LINES = 32; // on each side of a line for its noise
const LEAST_NOISE_LINES = 8;
const LOBE = 2.5; // lines to each side that a tone reaches under the Hann window
const MEDIAN_OF_NOISE = Math.sqrt(Math.LN2); // median of the amplitude of noise over its root mean square
const ABOVE_NOISE = 2.5; // of the noise's root mean square: noise alone reaches it in one line of 500
const MARGIN = 0.1; // of a part, on either side: the pinned record may run at another speed

/** Contiguous lines spaced by `step`; the first is at `first` steps. */
class FineLines {
  constructor(step, first, amplitude) {
    this.step = step;
    this.first = first;
    this.amplitude = amplitude;
  }

  static of({ resolution_hz: step, frequency_hz: x, amplitude }) {
    return new FineLines(step, Math.round((x[0] ?? 0) / step), amplitude);
  }

  /** Index of the largest line within `reach` lines of a frequency; -1 outside the range. */
  #greatest(frequency, reach) {
    const nearest = Math.round(frequency / this.step) - this.first;
    if (!(nearest >= 0 && nearest < this.amplitude.length)) return -1;
    let best = nearest;
    for (let n = Math.max(0, nearest - reach); n <= nearest + reach; n++)
      if (this.amplitude[n] > this.amplitude[best]) best = n;
    return best;
  }

  /**
   * The amplitude at a frequency: the maximum of the nearest three lines, as a tone may fall between two;
   * undefined outside.
   */
  at(frequency) {
    return this.amplitude[this.#greatest(frequency, 1)];
  }

  /**
   * The root-mean-square amplitude of the noise beside a frequency, from the median of lines on both sides,
   * without those that a tone there, or others at multiples of `spacing` from it, may reach; undefined where
   * too few lines are known.
   */
  noiseAt(frequency, spacing) {
    const place = frequency / this.step - this.first;
    const every = spacing / this.step;
    const isBetween = (n) => {
      const offset = Math.abs(n - place);
      return offset > LOBE && !(Math.abs(offset - Math.round(offset / every) * every) <= LOBE);
    };
    const beside = [];
    const nearest = Math.round(place);
    for (const direction of [-1, 1])
      for (let n = nearest, taken = 0; this.amplitude[n] !== undefined && taken < NOISE_LINES; n += direction)
        if (isBetween(n)) {
          beside.push(this.amplitude[n]);
          taken += 1;
        }
    if (beside.length < LEAST_NOISE_LINES) return undefined;
    return beside.sort((a, b) => a - b)[beside.length >> 1] / MEDIAN_OF_NOISE;
  }

  /** The same lines with other amplitudes, from frequency and amplitude. */
  map(change) {
    const changed = this.amplitude.map((each, n) => change((this.first + n) * this.step, each));
    return new FineLines(this.step, this.first, changed);
  }

  /** The local maxima between two frequencies. */
  peaks([from, to]) {
    const found = [];
    const [low, high] = [Math.ceil(from / this.step), Math.floor(to / this.step)].map((n) => n - this.first);
    for (let n = Math.max(0, low); n <= Math.min(high, this.amplitude.length - 1); n++) {
      const amplitude = this.amplitude[n];
      const [before, after] = [this.amplitude[n - 1] ?? 0, this.amplitude[n + 1] ?? 0];
      if (amplitude > before && amplitude >= after)
        found.push({ x: (this.first + n) * this.step, amplitude });
    }
    return found;
  }

  /** Whether all lines of a part are known. */
  covers([from, to]) {
    const end = this.first + this.amplitude.length;
    return from / this.step >= this.first - 1 && to / this.step <= end;
  }

  /** The frequency of the largest line within `reach` lines; undefined outside. */
  peakNear(frequency, reach) {
    const best = this.#greatest(frequency, reach);
    return best < 0 ? undefined : (this.first + best) * this.step;
  }
}

/** The amplitude at a frequency at full resolution; undefined when those lines are not known. */
export function amplitudeAt({ fine }, frequency) {
  return fine.map((lines) => lines.at(frequency)).find((amplitude) => amplitude !== undefined);
}

/**
 * Whether a line is no higher than the noise beside it; undefined where the noise is not known.
 * Further lines may stand at multiples of `spacing` from it.
 */
export function isInNoise({ fine }, { x, amplitude }, spacing) {
  const noise = fine.map((lines) => lines.noiseAt?.(x, spacing)).find((level) => level !== undefined);
  return noise === undefined ? undefined : amplitude < ABOVE_NOISE * noise;
}

/** What is said of lines in the noise. */
export const NOISE_WORDS = `in the noise: less than ${ABOVE_NOISE} times the noise beside the line`;

/** The frequency of the peak within `reach` lines; undefined when those lines are not known. */
export function peakNear({ fine }, frequency, reach) {
  return fine.map((lines) => lines.peakNear(frequency, reach)).find((peak) => peak !== undefined);
}

/** The `count` largest peaks of a part in descending order; null when its lines are not all known. */
export function greatestPeaks({ fine, frequency_hz: x }, range, count) {
  const [from, to] = range;
  const part = [from, Math.min(to, x.at(-1) ?? to)];
  const lines = fine.find((each) => each.covers(part));
  if (!lines) return null;
  return lines
    .peaks(part)
    .sort((a, b) => b.amplitude - a.amplitude)
    .slice(0, count);
}

/**
 * A spectrum with other amplitudes, also in its fine lines; `change` maps frequency and amplitude to an
 * amplitude.
 */
export function mapLines(spectrum, change) {
  const over = ({ frequency_hz: x, amplitude }) => amplitude.map((each, n) => change(x[n], each));
  const { fine, part, mesh_harmonics: harmonics } = spectrum;
  return {
    ...spectrum,
    amplitude: over(spectrum),
    fine: fine.map((lines) => lines.map(change)),
    ...(part && { part: { ...part, amplitude: over(part) } }),
    ...(harmonics && {
      mesh_harmonics: harmonics.map((line) => ({
        ...line,
        amplitude: change(line.frequency_hz, line.amplitude),
        ...(line.baseline_amplitude && {
          baseline_amplitude: change(line.frequency_hz, line.baseline_amplitude),
        }),
      })),
    }),
  };
}

/**
 * A spectrum reduced to at most `most` points in `range`, each the maximum of its stretch; the reduced part
 * is `part`.
 */
export function thinned(spectrum, range, most) {
  const [from, to] = range;
  const { frequency_hz: x, amplitude } = spectrum;
  const [first, last] = [x.findIndex((value) => value >= from), x.findLastIndex((value) => value <= to)];
  if (first < 0 || last - first < most) return spectrum;
  const wide = Math.ceil((last - first + 1) / most);
  const kept = [];
  for (let begin = 0; begin < x.length; begin += wide) {
    let best = begin;
    for (let n = begin; n < Math.min(begin + wide, x.length); n++)
      if (amplitude[n] > amplitude[best]) best = n;
    kept.push(best);
  }
  return {
    ...spectrum,
    reduced: true,
    frequency_hz: kept.map((n) => x[n]),
    amplitude: kept.map((n) => amplitude[n]),
  };
}

/** Every line between two frequencies; `ask(from, to, points)` requests some of them from the server. */
async function linesOf(ask, step, [from, to]) {
  const [first, last] = [Math.max(0, Math.floor(from / step)), Math.ceil(to / step)];
  const amplitude = [];
  for (let low = first; low <= last; low += MAX_LINES) {
    const high = Math.min(last, low + MAX_LINES - 1);
    // Half a line more, so that rounding loses none
    const part = await ask(Math.max(0, (low - 0.5) * step), (high + 0.5) * step, MAX_LINES);
    amplitude.push(part.amplitude);
    if (part.amplitude.length < high - low + 1) break; // the spectrum ends here
  }
  return new FineLines(step, first, amplitude.flat());
}

/** The points of the whole spectrum with those of a part replaced. */
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
 * A spectrum with its `fine` lines: those of the visible `part`, which is drawn from them, and those in
 * `read`. Both are `[from, to]` or null; `ask(from, to, points)` requests lines from the server.
 */
export async function withFineLines(spectrum, part, read, ask) {
  if (!spectrum.reduced || spectrum.frequency_hz.length === 0)
    return { ...spectrum, fine: [FineLines.of(spectrum)] };
  const { resolution_hz: step } = spectrum;
  const fine = read ? [await linesOf(ask, step, read)] : [];
  if (!part) return { ...spectrum, fine };
  const margin = MARGIN * (part[1] - part[0]);
  const shown = await ask(Math.max(0, part[0] - margin), part[1] + margin, MAX_DRAWN);
  if (!shown.reduced) fine.push(FineLines.of(shown));
  return { ...spectrum, ...spliced(spectrum, shown), fine, part: shown };
}

/** The frequency range that a cursor reads; null without a cursor. */
export function readByCursor(cursor, spectrum) {
  return cursor && cursorReach(cursor, spectrum.frequency_hz.at(-1));
}
