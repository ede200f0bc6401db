// Two records above one another with the same axis and scale: overlaid, the stronger would hide the weaker.

import { clock } from "./format.js";
import { palette } from "./plots.js";

const GAP = 0.07; // between the halves, as a fraction of the plot

/** The drawing of a record with that of the pinned one, `drawing.others`, below it. */
export function compared(drawing, selected, pinned) {
  const colour = palette();
  const { layout, traces, others } = drawing;
  const half = (1 - GAP) / 2;
  const name = (words, record, ink, y) => ({
    xref: "paper",
    x: 1,
    xanchor: "right",
    yref: "paper",
    y,
    yanchor: "top",
    text: `${words}, ${clock(record.start_time)}`,
    showarrow: false,
    bgcolor: colour.surface,
    borderpad: 2,
    font: { color: ink },
  });
  return {
    ...drawing,
    isCompared: true,
    traces: [...traces, ...others.map((trace) => ({ ...trace, yaxis: "y2" }))],
    layout: {
      ...layout,
      xaxis: { ...layout.xaxis, anchor: "y2" },
      yaxis: { ...layout.yaxis, domain: [1 - half, 1] },
      yaxis2: { ...layout.yaxis, domain: [0, half], matches: "y" },
      annotations: [
        ...(layout.annotations ?? []),
        name("selected", selected, colour.accent, 1),
        name("pinned", pinned, colour.other, half),
      ],
    },
  };
}
