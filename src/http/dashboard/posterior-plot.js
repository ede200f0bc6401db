// Posterior over the wear depth of one record.

import { depth } from "./format.js";
import { palette, verticalLine } from "./plots.js";

/** Probabilities of grid cells as a density, independent of the grid step. */
function density({ wear_um: x, probability }) {
  return probability.map((p, index) => {
    const left = x[Math.max(0, index - 1)];
    const right = x[Math.min(x.length - 1, index + 1)];
    const inside = index > 0 && index < x.length - 1;
    const width = inside ? (right - left) / 2 : right - left;
    return width > 0 ? p / width : p;
  });
}

function mark(x, text, colour, ground, xanchor) {
  return {
    x,
    yref: "paper",
    y: 1,
    text,
    showarrow: false,
    xanchor,
    xshift: xanchor === "left" ? 4 : -4,
    yanchor: "top",
    bgcolor: ground,
    font: { color: colour },
  };
}

/** Draws a posterior with its interval, the limits, and the reference if any. */
export function posteriorDrawing(wear, limits, reference, revision) {
  const colour = palette();
  const { wear_um: x } = wear.posterior;
  const y = density(wear.posterior);
  const { low_um: low, high_um: high, median_um: median } = wear;
  const inside = x
    .map((value, index) => ({ value, y: y[index] }))
    .filter(({ value }) => value >= low && value <= high);
  // Probability beyond the library's end is lumped there and would dwarf the rest
  const rest = Math.max(...y.slice(0, -1));
  const heaped = y.at(-1) > 3 * rest;
  const top = heaped ? 1.6 * rest : 1.2 * Math.max(...y);
  const entries = [
    ["line", colour.accent, `median ${depth(median)} µm`],
    ["band", colour.band, `90 %: ${depth(low)} to ${depth(high)} µm`],
  ];
  const shapes = [verticalLine(median, colour.accent, "solid", 2)];
  const annotations = heaped
    ? [
        {
          ...mark(
            x.at(-1),
            `↑ ${Math.round(100 * wear.posterior.probability.at(-1))} % at the end`,
            colour.accent,
            colour.surface,
            "right",
          ),
          y: 0.86,
        },
      ]
    : [];
  if (reference != null) {
    shapes.push(verticalLine(reference, colour.reference, "dot", 2));
    entries.push(["dot", colour.reference, `reference ${depth(reference)} µm`]);
  }
  for (const [name, value, dash] of [
    ["warning", limits?.warning_um, "dash"],
    ["danger", limits?.danger_um, "solid"],
  ]) {
    if (value == null || value > x.at(-1)) continue;
    shapes.push(verticalLine(value, colour[name], dash, 1.5));
    annotations.push(mark(value, name, colour[name], colour.surface, name === "danger" ? "left" : "right"));
  }
  return {
    traces: [
      {
        x: inside.map((point) => point.value),
        y: inside.map((point) => point.y),
        mode: "lines",
        line: { width: 0 },
        fill: "tozeroy",
        fillcolor: colour.band,
        hoverinfo: "skip",
      },
      {
        x,
        y,
        mode: "lines",
        line: { color: colour.accent, width: 1.5 },
        hovertemplate: "%{x:.0f} µm: %{y:.3g} per µm<extra></extra>",
      },
    ],
    legend: entries,
    table: () => [
      ["wear_um", x],
      ["probability", wear.posterior.probability],
    ],
    sub: `Probability density of the wear depth, given this record and all earlier ones.${wear.at_least_um != null ? ` The library ends at ${depth(x.at(-1))} µm; the wear may be deeper.` : ""}`,
    summary: `Posterior over wear depth: median ${depth(median)} µm, 90 % interval ${depth(low)} to ${depth(high)} µm.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      xaxis: { title: { text: "Wear depth (µm)" }, range: [x[0], x.at(-1)] },
      yaxis: { title: { text: "Density (1/µm)" }, range: [0, top] },
      shapes,
      annotations,
    },
  };
}
