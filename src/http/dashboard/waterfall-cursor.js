// The readings of a cursor over a waterfall: the cells of the latest record.

import { ORDERS } from "./spectrum-plot.js";

const decibels = (level) => 10 ** (level / 20);

/** The latest record of a waterfall as a spectrum; `teeth` are those of the driving gear. */
export function latestSpectrum(
  { items, position, axis, unit, mesh_position: mesh, resolution = position[1] - position[0] },
  teeth,
) {
  const levels = items.findLast(({ level_db: levels }) => levels)?.level_db;
  if (!levels || position.length < 2) return null;
  const cell = (x) => Math.round((x - position[0]) / resolution);
  const amplitude = (at) => (levels[at] === undefined ? 0 : decibels(levels[at]));
  const peakNear = (x) => {
    const near = [-1, 0, 1].map((step) => cell(x) + step).filter((at) => position[at] !== undefined);
    return position[near.reduce((a, b) => (amplitude(b) > amplitude(a) ? b : a), near[0])];
  };
  const shaft = axis === "orders" ? 1 : mesh && teeth ? mesh / teeth : null;
  return {
    ...(axis === "orders" && { axis: ORDERS }),
    frequency_hz: position,
    resolution_hz: resolution,
    unit,
    mesh_frequency_hz: mesh ?? null,
    shaft_speed_hz: shaft,
    fine: [{ at: (x) => amplitude(cell(x)), peakNear }],
  };
}
