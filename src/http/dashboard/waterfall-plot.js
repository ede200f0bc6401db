// The drawing of a waterfall: one line of cells a record, coloured by level.

import { count, number, unit, utc } from "./format.js";
import { palette } from "./plots.js";

// dark to bright with even steps in lightness, told apart with any colour vision (after viridis)
const SCALE = [[0, "#0d0a2b"], [0.2, "#3b2f7d"], [0.4, "#31688e"], [0.6, "#1f9d87"], [0.8, "#7ad151"], [1, "#fde725"]];
const TICKS = 9;

function timeTicks(items) {
  const oneDay = items[0].start_time.slice(0, 10) === items.at(-1).start_time.slice(0, 10);
  const picked = Array.from({ length: Math.min(TICKS, items.length) }, (_, n) => Math.round((n * (items.length - 1)) / Math.max(1, Math.min(TICKS, items.length) - 1)));
  return { tickvals: picked, ticktext: picked.map((n) => items[n].start_time.slice(oneDay ? 11 : 5, 16).replace("T", " ")) };
}

/** The drawing of `range` decibels below the highest level, or words where there is nothing to draw. */
export function waterfallDrawing({ items, position, axis, unit: unitName, window, mesh_position: mesh, channel, reduced }, range, selected, revision) {
  const known = items.filter((item) => item.level_db);
  if (known.length === 0) return axis === "orders" ? "No record of this channel has a known shaft speed, so there are no orders." : "No records of this channel yet.";
  const colour = palette();
  const top = known.reduce((highest, { level_db: levels }) => levels.reduce((a, b) => Math.max(a, b), highest), -Infinity);
  const suffix = axis === "orders" ? "order" : "Hz";
  const trace = {
    type: "heatmap",
    x: position,
    z: known.map((item) => item.level_db),
    customdata: known.map((item) => position.map(() => item.segment_id)),
    zmin: top - range,
    zmax: top,
    zsmooth: false,
    colorscale: SCALE,
    colorbar: { title: { text: `Peak amplitude (dB re 1 ${unit(unitName) || "unit"})`, side: "right" }, thickness: 14, outlinewidth: 0, tickfont: { color: colour.ink }, len: 1 },
    text: known.map((item) => utc(item.start_time)),
    hovertemplate: `%{x:.1f} ${suffix}: %{z:.1f} dB<extra></extra>`,
  };
  const harmonics = mesh ? Array.from({ length: 12 }, (_, n) => (n + 1) * mesh).filter((x) => x <= position.at(-1)) : [];
  const row = known.findIndex((item) => item.segment_id === selected);
  const shapes = row < 0 ? [] : [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: row, y1: row, line: { color: "#ffffff", width: 1.5, dash: "dot" } }];
  const annotations = harmonics.map((x, n) => ({ x, yref: "paper", y: 1, yanchor: "bottom", text: `${n + 1}×`, showarrow: false, font: { color: colour.reference } }));
  const first = known[0].start_time.slice(0, 10);
  const last = known.at(-1).start_time.slice(0, 10);
  return {
    traces: [trace],
    legend: [],
    table: () => [["start_time", known.map((item) => item.start_time)], ["segment_id", known.map((item) => item.segment_id)], ...position.map((x, n) => [`${number(x, 6)} ${suffix} (dB)`, known.map((item) => item.level_db[n])])],
    sub: `Channel ${channel}, ${count(known.length)} records${reduced ? " picked evenly over the life" : ""}; the highest peak amplitude in each cell, ${window === "hann" ? "Hann" : window} window. Click a line to open its record; ${harmonics.length ? "1×, 2×… are mesh harmonics." : ""}`,
    summary: `Heat map of ${known.length} spectra from ${utc(known[0].start_time)} to ${utc(known.at(-1).start_time)}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      margin: { l: 8, r: 8, t: 24, b: 8 },
      xaxis: { title: { text: axis === "orders" ? "Order of the driving shaft (–)" : "Frequency (Hz)" }, separatethousands: true },
      yaxis: { title: { text: `Start of record (UTC), ${first === last ? first : `${first} to ${last}`}` }, ...timeTicks(known), range: [-0.5, known.length - 0.5] },
      shapes,
      annotations,
    },
  };
}
