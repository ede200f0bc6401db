// Records above one another with the same axis and scale: overlaid, the stronger would hide the weaker.

import { clock } from "./format.js";
import { palette } from "./plots.js";

const GAP = 0.07; // between two lanes, as a fraction of the plot
const ABOVE = 0.27; // the same times the number of lanes where their words need the gap
const WORDS_PX = 20;

/** A drawing in lanes from top to bottom, each `{ traces, words, colour }`; the words stand `above` or in it. */
function stacked(drawing, lanes, above = false) {
  const { surface } = palette();
  const { layout } = drawing;
  const gap = above ? ABOVE / lanes.length : GAP;
  const height = (1 - gap * (lanes.length - 1)) / lanes.length;
  const topOf = (lane) => 1 - lane * (height + gap);
  const suffix = (lane) => (lane ? String(lane + 1) : "");
  const axes = lanes.map((_, lane) => [
    `yaxis${suffix(lane)}`,
    {
      ...layout.yaxis,
      domain: [Math.max(0, topOf(lane) - height), topOf(lane)],
      ...(lane && { matches: "y" }),
      // The middle lane names the quantity of all
      ...(above && { nticks: 4, ...(lane !== (lanes.length - 1) >> 1 && { title: undefined }) }),
    },
  ]);
  const names = lanes.map(({ words, colour }, lane) => ({
    xref: "paper",
    x: 1,
    xanchor: "right",
    yref: "paper",
    y: topOf(lane),
    yanchor: above ? "bottom" : "top",
    text: words,
    showarrow: false,
    bgcolor: surface,
    borderpad: 2,
    font: { color: colour },
  }));
  return {
    ...drawing,
    isCompared: true,
    lanes: lanes.length,
    traces: lanes.flatMap(({ traces }, lane) =>
      traces.map((trace) => (lane ? { ...trace, yaxis: `y${suffix(lane)}` } : trace)),
    ),
    layout: {
      ...layout,
      xaxis: { ...layout.xaxis, anchor: `y${suffix(lanes.length - 1)}` },
      ...Object.fromEntries(axes),
      annotations: [...(layout.annotations ?? []), ...names],
      ...(above && { margin: { l: 8, r: 14, t: WORDS_PX, b: 8 } }),
    },
  };
}

/** The drawing of a record with that of the pinned one, `drawing.others`, below it. */
export function compared(drawing, selected, pinned) {
  const { accent, other } = palette();
  return stacked(drawing, [
    { traces: drawing.traces, words: `selected, ${clock(selected.start_time)}`, colour: accent },
    { traces: drawing.others, words: `pinned, ${clock(pinned.start_time)}`, colour: other },
  ]);
}

/** The last part of a record's name. */
const timeOf = (name) => name.split(" · ").at(-1);

/**
 * The drawing of several records, each in a lane of its own, the first on top.
 * @param {import("./layers.js").Layer[]} layers
 */
export function inLanes(drawing, layers) {
  const isNarrow = matchMedia("(max-width: 40rem)").matches;
  const traces = [drawing.traces, ...drawing.others.map((trace) => [trace])];
  return stacked(
    drawing,
    layers.map(({ name, colour }, lane) => ({
      traces: traces[lane],
      words: isNarrow ? timeOf(name) : name,
      colour,
    })),
    true,
  );
}
