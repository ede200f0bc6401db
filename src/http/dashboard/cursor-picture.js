// A cursor's lines in a saved picture; on the page they are an overlay over the plot.

import { cursorLines } from "./cursor-lines.js";
import { palette, verticalLine } from "./plots.js";

/**
 * Adds a cursor's lines to a drawing; on the page they are an overlay instead. `isAbove` draws them in white
 * above an opaque plot.
 */
export function withCursor(drawing, cursor, end, isAbove = false) {
  if (!cursor || typeof drawing === "string") return drawing;
  const { "series-4": ink, surface } = palette();
  const lines = cursorLines(cursor, end);
  const { shapes = [], annotations = [] } = drawing.layout;
  return {
    ...drawing,
    layout: {
      ...drawing.layout,
      shapes: [
        ...shapes,
        ...lines.map(({ x }) =>
          isAbove ? { ...verticalLine(x, "#fff"), layer: "above" } : verticalLine(x, ink),
        ),
      ],
      annotations: [
        ...annotations,
        ...lines.map(({ x, label: text }) => ({
          x,
          yref: "paper",
          y: 0,
          yanchor: "bottom",
          xanchor: "left",
          text,
          showarrow: false,
          bgcolor: surface,
          font: { color: ink, size: 10 },
        })),
      ],
    },
  };
}
