// The axes of a plot that is drawn without the plotting library: margins, ranges and ticks. They follow
// Plotly's rules, so that nothing moves when Plotly takes over.

import { textSize } from "./static-text.js";
import { count } from "./format.js";

const [SECOND, MINUTE, HOUR, DAY] = [1e3, 6e4, 36e5, 864e5];
const MONTH = 30.4375 * DAY; // on average
const A_SUNDAY = Date.UTC(2000, 0, 2); // weeks begin on Sundays
export const TICK = { length: 5, width: 1 };

/** @typedef {{ at: number, words: string, more?: string }} Tick */
/** @typedef {{ l: number, r: number, t: number, b: number, w: number, h: number }} StaticSize */
/**
 * @typedef {{ id: string, letter: string, spec: any, type: string, range: number[], offset: number,
 *   length: number, ticks: Tick[], depth: number, at: (coordinate: number) => number }} StaticAxis
 */

/** A value on its axis: times in milliseconds, logarithms on logarithmic axes, NaN for none. */
export function coordinate(type, value) {
  if (value === null || value === undefined) return NaN;
  if (type === "log") return value > 0 ? Math.log10(value) : NaN;
  // The plot shows times as written
  if (type === "date") return typeof value === "number" ? value : Date.parse(value.replace(/Z?$/, "Z"));
  return Number(value);
}

/** The smallest of `sizes` beyond `least`; otherwise the largest one. */
const beyond = (sizes, least) => sizes.find((size) => size > least) ?? sizes.at(-1);

/** The smallest of 1, 2 and 5 times a power of ten beyond `least`. */
function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return beyond([2, 5, 10], least / power) * power;
}

/**
 * The multiples of a step within a range.
 * @param {number[]} range
 * @param {number} step
 */
const multiples = ([from, to], step, origin = 0) => {
  const first = Math.ceil((from - origin) / step - 1e-6);
  const last = Math.floor((to - origin) / step + 1e-6);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, n) => origin + (first + n) * step);
};

const PREFIXES = { "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };

/** Numbers of an axis with as many decimals as its step needs; very large and small ones with a prefix. */
function numbers(values, step, { exponentformat: exponents }) {
  const greatest = Math.floor(Math.log10(Math.max(step, ...values.map(Math.abs))) + 0.01);
  const power = exponents !== "none" && Math.abs(greatest) > 3 ? 3 * Math.round((greatest - 1) / 3) : 0;
  const places = Math.max(0, power - Math.floor(Math.log10(step) + 1e-9));
  return values.map((value) => {
    const [whole, part] = String(Number(Math.abs(value / 10 ** power).toFixed(places))).split(".");
    const digits = `${whole.length > 4 ? count(whole) : whole}${part ? `.${part}` : ""}`;
    if (Number(digits) === 0) return "0";
    return `${value < 0 ? "−" : ""}${digits}${PREFIXES[power] ?? `e${power}`}`;
  });
}

const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/** The words of times `step` apart, and what stands below them where it changes: the date or the year. */
function times(values, step) {
  let before = "";
  return values.map((value) => {
    const time = new Date(value);
    const year = String(time.getUTCFullYear());
    const month = MONTHS[time.getUTCMonth()];
    if (step >= 12 * MONTH) return { words: year };
    if (step >= MONTH) return { words: `${month} ${year}` };
    const day = `${month} ${time.getUTCDate()}`;
    const clock = time.toISOString().slice(11, step >= MINUTE ? 16 : step >= SECOND ? 19 : 23);
    const [words, more] = step >= DAY ? [day, year] : [clock, `${day}, ${year}`];
    const isNew = more !== before;
    before = more;
    return { words, ...(isNew && { more }) };
  });
}

/**
 * Times of a calendar or a clock within a range, about `most` of them.
 * @param {number[]} range
 * @param {number} most
 */
function timeTicks([from, to], most) {
  const least = (to - from) / most;
  if (2 * least > MONTH) {
    const months =
      2 * least > 12 * MONTH ? 12 * roundStep(least / (12 * MONTH)) : beyond([1, 2, 3, 6, 12], least / MONTH);
    const ordinal = (time) => 12 * (new Date(time).getUTCFullYear() - 2000) + new Date(time).getUTCMonth();
    const values = multiples([ordinal(from) - months, ordinal(to) + 1], months)
      .map((month) => Date.UTC(2000, month))
      .filter((time) => time >= from && time <= to);
    return { values, step: months * MONTH };
  }
  const [unit, sizes] =
    2 * least > DAY
      ? [DAY, [1, 2, 3, 7, 14]]
      : 2 * least > HOUR
        ? [HOUR, [1, 2, 3, 6, 12]]
        : [2 * least > MINUTE ? MINUTE : SECOND, [1, 2, 5, 10, 15, 30]];
  const step = 2 * least > SECOND ? unit * beyond(sizes, least / unit) : roundStep(least);
  return { values: multiples([from, to], step, A_SUNDAY), step };
}

/** @returns {Tick[]} */
function ticksOf({ spec, type, range: ends, length, letter }) {
  const range = [Math.min(...ends), Math.max(...ends)];
  const most = spec.nticks || Math.min(9, Math.max(4, length / (letter === "y" ? 40 : 80))) + 1;
  const labelled = (values, words) => values.map((at, n) => ({ at, words: words[n] }));
  if (spec.tickmode === "array")
    return labelled(
      spec.tickvals.map((value) => coordinate(type, value)),
      spec.ticktext,
    ).filter(({ at }) => at >= range[0] && at <= range[1]);
  if (type === "date") {
    const { values, step } = timeTicks(range, most);
    return times(values, step).map((words, n) => ({ at: values[n], ...words }));
  }
  if (type === "log") {
    const isNarrow = range[1] - range[0] < 1;
    if (!isNarrow) {
      const values = multiples(range, Math.ceil((range[1] - range[0]) / most));
      return labelled(
        values,
        values.map((power) => numbers([10 ** power], 10 ** power, spec)[0]),
      );
    }
    const [from, to] = range.map((power) => 10 ** power);
    const step = roundStep((to - from) / (1.5 * most));
    const values = multiples([from, to], step);
    return labelled(values.map(Math.log10), numbers(values, step, spec));
  }
  const step = spec.dtick ?? roundStep((range[1] - range[0]) / most);
  const values = multiples(range, step);
  return labelled(values, numbers(values, step, spec));
}

/** The range that shows `extents`, each from a low to a high coordinate with room in pixels beside them. */
function fittedRange(extents, { rangemode }, length) {
  if (extents.length === 0) return [-1, 6]; // of an empty plot
  const [low, high] = [
    Math.min(...extents.map(({ low }) => low)),
    Math.max(...extents.map(({ high }) => high)),
  ];
  const toZero = rangemode === "tozero";
  if (low === high && !(toZero && low !== 0)) return toZero ? [0, 1] : [low - 1, high + 1];
  // The two ends that need the most room
  let best = { scale: 0, low, below: 0, high, above: 0 };
  const lows = toZero && low >= 0 ? [{ low: 0, below: 0 }] : extents;
  const highs = toZero && high <= 0 ? [{ high: 0, above: 0 }] : extents;
  for (const { low: from, below } of lows)
    for (const { high: to, above } of highs) {
      const scale = (to - from) / Math.max(length / 10, length - below - above);
      if (scale > best.scale) best = { scale, low: from, below, high: to, above };
    }
  return [best.low - best.scale * best.below, best.high + best.scale * best.above];
}

const ROOM = 0.05; // beside the values, as a fraction of the axis

/** What an axis without a range has to show. */
function extentsOn({ id, letter, type, length }, curves, { shapes = [], annotations = [] }, boxOf) {
  const extents = [];
  const add = (values, below, above = below) => {
    let [low, high] = [Infinity, -Infinity];
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low <= high && Number.isFinite(low + high)) extents.push({ low, high, below, above });
  };
  for (const curve of curves) {
    if (curve[letter].id !== id) continue;
    const values = curve[letter].values;
    const isMarked = curve.trace.mode.includes("markers");
    const marker = isMarked ? Math.max((curve.trace.marker?.size ?? 6) / 1.6, 3) : 0;
    const isTight = letter === "x" && (!isMarked || curve.trace.fill === "tozeroy");
    add(values, isTight ? 0 : ROOM * length + marker);
    if (letter === "y" && curve.trace.fill === "tozeroy") add([0], 0);
    const errors = letter === "y" ? curve.trace.error_y?.array : undefined;
    if (errors)
      add(
        errors.flatMap((error, n) => [values[n] - error, values[n] + error]),
        ROOM * length,
      );
  }
  for (const shape of shapes)
    if ((shape[`${letter}ref`] ?? letter) === id && shape[`${letter}sizemode`] !== "pixel")
      add(
        [shape[`${letter}0`], shape[`${letter}1`]].map((end) => coordinate(type, end)),
        (shape.line?.width ?? 2) / 2,
      );
  for (const annotation of annotations) {
    if ((annotation[`${letter}ref`] ?? letter) !== id) continue;
    const { before, after } = boxOf(annotation)[letter];
    add([type === "date" ? coordinate(type, annotation[letter]) : annotation[letter]], before, after);
  }
  return extents;
}

/**
 * The axes of a layout in a frame of pixels, `{ axes, size }`; `size` has the margins and the area within.
 * @returns {{ axes: Record<string, StaticAxis>, size: StaticSize }}
 */
export function axesOf(curves, layout, frame, boxOf) {
  const font = { size: layout.font.size, family: layout.font.family };
  const titleSize = Math.round(1.2 * font.size);
  const descent = Math.round(textSize("0", font).descent);
  const place = (margin) => {
    const size = { ...margin, w: frame.width - margin.l - margin.r, h: frame.height - margin.t - margin.b };
    /** @type {Record<string, StaticAxis>} */
    const axes = {};
    for (const key of Object.keys(layout).filter((name) => /^[xy]axis\d*$/.test(name))) {
      const spec = layout[key];
      const [id, letter] = [key.replace("axis", ""), key[0]];
      const [from, to] = spec.domain ?? [0, 1];
      const length = (letter === "x" ? size.w : size.h) * (to - from);
      const offset = letter === "x" ? size.l + size.w * from : size.t + size.h * (1 - to);
      const type = spec.type ?? "linear";
      const own = { id, letter, spec, type, length, offset };
      const range =
        spec.range?.map((end) => (type === "date" ? coordinate(type, end) : end)) ??
        fittedRange(extentsOn(own, curves, layout, boxOf), spec, length);
      const scale = length / (range[1] - range[0]);
      const at =
        letter === "x"
          ? (value) => offset + (value - range[0]) * scale
          : (value) => offset + length - (value - range[0]) * scale;
      const ticks = spec.visible === false ? [] : ticksOf({ ...own, range });
      const gap = TICK.length + 0.2 * font.size + TICK.width;
      const lines = ticks.some(({ more }) => more) ? 2 : 1;
      const depth =
        letter === "x"
          ? gap + font.size + descent + 1.3 * font.size * (lines - 1)
          : gap - TICK.width / 2 + Math.max(0, ...ticks.map(({ words }) => textSize(words, font).width));
      axes[id] = { ...own, range, at, ticks, depth: ticks.length ? depth : 0 };
    }
    return { axes, size };
  };
  const { l, r, t, b } = layout.margin;
  const beside = Math.min(12, l, r, t, b); // what needs more than a margin keeps from the edge
  const room = ({ axes, size }) => {
    const margin = { ...layout.margin };
    const widen = (side, excess) => {
      if (excess > 0) margin[side] = Math.max(margin[side], excess + beside);
    };
    for (const axis of Object.values(axes)) {
      const { spec, letter, depth, ticks, offset, length, at } = axis;
      if (spec.automargin === false || spec.visible === false) continue;
      const title = spec.title?.text ? spec.title.standoff + 0.7 * titleSize : 0;
      if (letter === "y") {
        widen("l", depth + title);
        const highest = Math.min(...ticks.map(({ at: value }) => at(value)));
        widen("t", size.t - (highest - 0.65 * font.size));
      } else {
        const below = axes[spec.anchor ?? "y"];
        if (below.offset + below.length > size.t + size.h - 1) widen("b", depth + title);
        for (const { at: value, words, more } of ticks) {
          const half = Math.max(textSize(words, font).width, more ? textSize(more, font).width : 0) / 2;
          widen("r", at(value) + half - offset - length);
          widen("l", offset - at(value) + half);
        }
      }
    }
    for (const side of ["l", "r", "t", "b"]) margin[side] = Math.round(margin[side]);
    return margin;
  };
  // The ticks depend on the margins, and these on the ticks
  return place(room(place(room(place(layout.margin)))));
}
