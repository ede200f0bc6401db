// The zones of ISO 20816 behind the trend of a machine's velocity, as far as its description has them.

import { number } from "./format.js";
import { translucent } from "./theme.js";

/** Each zone with its colour of the one palette of severity; B is as calm as what is still being learnt. */
const ZONES = [
  ["A", "normal"],
  ["B", "learning"],
  ["C", "warning"],
  ["D", "danger"],
];
const OPACITY = 0.16;

/** A limit up to this many times the greatest value is brought into view. */
const REACH = 2;

/** Room above the greatest and, on a log scale, below the least of what is in view. */
const ROOM = 1.1;

/** How far the outer zones go beyond what is in view, for who zooms out. */
const BEYOND = 3;

/**
 * What is drawn for `limits` in mm/s, those between A and B, B and C, C and D, behind `values` on the vertical
 * axis with this suffix, on which `levels` are to be in view. `range` is that of the axis, which the zones
 * would widen by themselves.
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
  const said = ["to", "to", "to", "above"];
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
    // the letter of a zone stands beside its lower end
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
      `zone ${zone}, ${said[index]} ${number(limits[Math.min(index, 2)], 3)} mm/s`,
    ]),
  };
}
