// Draws a waterfall: one row of cells per record, coloured by level.

import { clock, count, number, span, unit } from "./format.js";
import { horizontalLine, palette } from "./plots.js";
import { written, zoneName } from "./time-zone.js";

// Dark to bright in even lightness steps, for any colour vision (after viridis)
/** @type {[number, string][]} */
const SCALE = [
  [0, "#0d0a2b"],
  [0.2, "#3b2f7d"],
  [0.4, "#31688e"],
  [0.6, "#1f9d87"],
  [0.8, "#7ad151"],
  [1, "#fde725"],
];
const TICKS = 9;
const GAP = 5; // times the usual interval between records, from which a pause is marked
const MAX_GAPS = 8; // the longest ones

function timeTicks(items) {
  const day = (item) => written(item.start_time).slice(0, 10);
  const oneDay = day(items[0]) === day(items.at(-1));
  const picked = Array.from({ length: Math.min(TICKS, items.length) }, (_, n) =>
    Math.round((n * (items.length - 1)) / Math.max(1, Math.min(TICKS, items.length) - 1)),
  );
  return {
    tickvals: picked,
    ticktext: picked.map((n) =>
      written(items[n].start_time)
        .slice(oneDay ? 11 : 5, 16)
        .replace("T", " "),
    ),
  };
}

/** Long pauses between records, whose rows follow each other all the same: `{ row, seconds }` each. */
function gapsOf(items) {
  const pauses = items.slice(1).map((item, n) => ({
    row: n + 0.5,
    seconds: (Date.parse(item.start_time) - Date.parse(items[n].start_time)) / 1000,
  }));
  const usual = pauses.map(({ seconds }) => seconds).sort((a, b) => a - b)[pauses.length >> 1];
  return pauses
    .filter(({ seconds }) => seconds > GAP * usual)
    .sort((a, b) => b.seconds - a.seconds)
    .slice(0, MAX_GAPS);
}

/** Marks of pauses: a line between two rows, with its length. */
const gapMarks = (gaps, colour) => ({
  shapes: gaps.map(({ row }) => horizontalLine(row, { color: colour.surface, width: 3 })),
  annotations: gaps.map(({ row, seconds }) => ({
    xref: "paper",
    x: 1,
    xanchor: "right",
    y: row,
    yanchor: "middle",
    text: `${span(seconds)} without records`,
    showarrow: false,
    bgcolor: colour.surface,
    font: { color: colour.ink },
  })),
});

/** Red, green and blue of 256 levels from lowest to highest. */
function lookup() {
  const stops = SCALE.map(([at, colour]) => ({
    at,
    rgb: [1, 3, 5].map((place) => Number.parseInt(colour.slice(place, place + 2), 16)),
  }));
  return Array.from({ length: 256 }, (_, n) => {
    const after = Math.max(
      1,
      stops.findIndex(({ at }) => at >= n / 255),
    );
    const [low, high] = [stops[after - 1], stops[after]];
    const part = (n / 255 - low.at) / (high.at - low.at);
    return low.rgb.map((value, channel) => Math.round(value + part * (high.rgb[channel] - value)));
  });
}

/** An image with one pixel per cell, first record on top; zooming moves it without repainting. */
function painted(items, cells, [low, high]) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [cells, items.length];
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(cells, items.length);
  const colours = lookup();
  items.forEach(({ level_db: levels }, row) => {
    for (let column = 0; column < cells; column++) {
      const part = ((levels[column] ?? low) - low) / (high - low);
      const colour = colours[Math.round(255 * Math.min(1, Math.max(0, part)))];
      pixels.data.set([...colour, 255], 4 * (row * cells + column));
    }
  });
  context.putImageData(pixels, 0, 0);
  return canvas.toDataURL("image/png");
}

/** Draws `range` decibels below the highest level, or returns a text when there is nothing to draw. */
export function waterfallDrawing(
  { items, position, axis, unit: unitName, window, mesh_position: mesh, channel, reduced },
  range,
  selected,
  revision,
) {
  const known = items.filter((item) => item.level_db);
  if (known.length === 0)
    return axis === "orders"
      ? "No record of this channel has a shaft speed, so there are no orders."
      : "This channel has no records yet.";
  const colour = palette();
  const top = known.reduce(
    (highest, { level_db: levels }) => levels.reduce((a, b) => Math.max(a, b), highest),
    -Infinity,
  );
  const suffix = axis === "orders" ? "order" : "Hz";
  const step = position.length > 1 ? position[1] - position[0] : 1;
  const picture = {
    type: "image",
    source: painted(known, position.length, [top - range, top]),
    x0: position[0],
    dx: step,
    y0: 0,
    dy: 1,
    hoverinfo: "none",
  };
  // An image has no colour bar; an empty trace provides it
  const bar = {
    title: { text: `Peak amplitude (dB re 1 ${unit(unitName) || "unit"})`, side: "right" },
    thickness: 14,
    outlinewidth: 0,
    tickfont: { color: colour.ink },
    len: 1,
  };
  const scale = {
    x: [null],
    y: [null],
    mode: "markers",
    hoverinfo: "skip",
    marker: { color: [top], cmin: top - range, cmax: top, colorscale: SCALE, showscale: true, colorbar: bar },
  };
  const harmonics = mesh
    ? Array.from({ length: 12 }, (_, n) => (n + 1) * mesh).filter((x) => x <= position.at(-1))
    : [];
  const row = known.findIndex((item) => item.segment_id === selected);
  const shapes = row < 0 ? [] : [horizontalLine(row, { color: "#ffffff", width: 1.5, dash: "dot" })];
  // Only some labels are written where they would overlap
  const width = matchMedia("(max-width: 40rem)").matches ? 200 : 800;
  const every = mesh ? Math.ceil(26 / ((mesh / position.at(-1)) * width)) : 1;
  const annotations = harmonics
    .map((x, n) => [x, n])
    .filter(([, n]) => n % every === 0)
    .map(([x, n]) => ({
      x,
      yref: "paper",
      y: 1,
      yanchor: "bottom",
      text: `${n + 1}×`,
      showarrow: false,
      font: { color: colour.reference },
    }));
  const gaps = gapMarks(gapsOf(known), colour);
  shapes.unshift(...gaps.shapes);
  annotations.push(...gaps.annotations);
  const first = written(known[0].start_time).slice(0, 10);
  const last = written(known.at(-1).start_time).slice(0, 10);
  return {
    traces: [picture, scale],
    cellAt: ([row, column]) => ({
      segment: known[row].segment_id,
      words: `${clock(known[row].start_time)}, ${number(position[column], 5)} ${suffix}: ${number(known[row].level_db[column], 3)} dB`,
    }),
    legend: [],
    table: () => [
      ["start_time", known.map((item) => item.start_time)],
      ["segment_id", known.map((item) => item.segment_id)],
      ...position.map((x, n) => [`${number(x, 6)} ${suffix} (dB)`, known.map((item) => item.level_db[n])]),
    ],
    sub: `Channel ${channel}, ${count(known.length)} records${reduced ? " sampled evenly" : ""}; the highest peak amplitude in each cell, ${window === "hann" ? "Hann" : window} window. One row per record${gaps.shapes.length ? "; long pauses are marked" : ""}. Click a line to open its record; a cursor reads the latest one.${harmonics.length ? " 1×, 2×… are mesh harmonics." : ""}`,
    summary: `Heat map of ${known.length} spectra from ${clock(known[0].start_time)} to ${clock(known.at(-1).start_time)}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      margin: { l: 8, r: 8, t: 24, b: 8 },
      xaxis: {
        exponentformat: "none",
        title: { text: axis === "orders" ? "Order of the driving shaft (–)" : "Frequency (Hz)" },
        range: [position[0] - step / 2, position.at(-1) + step / 2],
        constrain: "range",
      },
      yaxis: {
        title: { text: `Start of record (${zoneName()}), ${first === last ? first : `${first} to ${last}`}` },
        ...timeTicks(known),
        range: [-0.5, known.length - 0.5],
        scaleanchor: false,
        constrain: "range",
      },
      shapes,
      annotations,
    },
  };
}
