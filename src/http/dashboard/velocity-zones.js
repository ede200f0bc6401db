// The ISO 20816 zones behind the velocity trend.

import { number } from "./format.js";
import { translucent } from "./theme.js";

/** Each zone with its severity colour; B uses the colour of the learning state. */
const ZONES = [
  ["A", "normal"],
  ["B", "learning"],
  ["C", "warning"],
  ["D", "danger"],
];
const OPACITY = 0.16;

/** A limit up to this many times the largest value is brought into view. */
const REACH = 2;

/** Margin above the largest and, on a log scale, below the smallest visible value. */
const ROOM = 1.1;

/** How far the outer zones extend beyond the view, for zooming out. */
const BEYOND = 3;

/**
 * Zone shapes for `limits` in mm/s (A/B, B/C, C/D) behind `values` on the vertical axis with this suffix;
 * `levels` stay in view. `range` fixes the axis, which the shapes would otherwise widen.
 */
export function velocityZones(limits, suffix, { colour, logarithmic, values, levels }) {
  const seen = values.filter((value) => value > 0);
  const greatest = Math.max(limits[0], ...seen);
  const inView = [...seen, ...levels, ...limits.filter((limit) => limit <= REACH * greatest)];
  const top = ROOM * Math.max(...inView);
  const bottom = logarithmic ? Math.min(...inView) / ROOM : 0;
  const ends = [bottom / BEYOND, ...limits, BEYOND * Math.max(top, limits[2])];
  const yref = `y${suffix}`;
  const height = (value) => (logarithmic ? Math.log10(value) : value);
  const bounds = ["up to", "up to", "up to", "above"];
  return {
    shapes: ZONES.map(([zone, name], index) => ({
      name: `zone ${zone}`,
      type: "rect",
      layer: "below",
      xref: "paper",
      yref,
      x0: 0,
      x1: 1,
      y0: ends[index],
      y1: ends[index + 1],
      fillcolor: translucent(colour[name], OPACITY),
      line: { width: 0 },
    })),
    // A zone's letter is beside its lower end
    annotations: ZONES.map(([zone, name], index) => ({
      xref: "paper",
      x: 1.002,
      xanchor: "left",
      yref,
      y: height(Math.max(ends[index], bottom)),
      yanchor: "bottom",
      text: zone,
      showarrow: false,
      font: { color: colour[name] },
    })).filter((_, index) => ends[index] < top && ends[index + 1] > bottom),
    range: [bottom, top].map(height),
    entries: ZONES.map(([zone, name], index) => [
      "band",
      translucent(colour[name], 2 * OPACITY),
      `Zone ${zone}, ${bounds[index]} ${number(limits[Math.min(index, 2)], 3)} mm/s`,
    ]),
  };
}
