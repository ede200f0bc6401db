// The cepstrum: each family of equally spaced lines, such as sidebands, gives one peak at its period.

import { hertz, number } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";
import { palette, verticalLine } from "./plots.js";

/**
 * Draws cepstra, with the mesh and shaft periods of the first record's machine.
 * @param {import("./layers.js").Layer[]} layers
 */
export function cepstrumDrawing(layers, revision) {
  const colour = palette();
  const [{ data: cepstrum }, ...others] = layers;
  const { quefrency_s: seconds, shaft_speed_hz: shaft, teeth } = cepstrum;
  const x = seconds.map((second) => 1000 * second);
  const periods = [];
  if (shaft && teeth) periods.push({ name: "mesh", period: 1000 / (shaft * teeth[0]) });
  if (shaft) periods.push({ name: teeth ? "driving shaft" : "shaft", period: 1000 / shaft });
  if (shaft && teeth && teeth[0] !== teeth[1])
    periods.push({ name: "driven shaft", period: (1000 * teeth[1]) / (shaft * teeth[0]) });
  const shown = periods.filter(({ period }) => period <= x.at(-1));
  const places = shown.map(({ name, period }) => `${name} at ${number(period)} ms`);
  // The lowest quefrencies describe the transmission path and would dwarf all others
  const from = shaft && teeth ? 1000 / (shaft * teeth[0] * 4) : x[0];
  const heights = layers.flatMap(({ data }) =>
    data.value.filter((_, index) => 1000 * data.quefrency_s[index] >= from),
  );
  const [low, high] = heights.reduce(([a, b], y) => [Math.min(a, y), Math.max(b, y)], [0, 0]);
  const line = ({ data, colour: stroke, pointed }) => ({
    x: data.quefrency_s.map((second) => 1000 * second),
    y: data.value,
    mode: "lines",
    line: { color: stroke, width: 1 },
    hovertemplate: `${pointed}%{x:.2f} ms: %{y:.3g}<extra></extra>`,
  });
  return {
    traces: [line(layers[0])],
    others: others.map(line),
    legend: recordEntries(layers),
    table: () =>
      recordColumns(layers, (data) => [
        ["quefrency_s", data.quefrency_s],
        ["value", data.value],
      ]),
    sub: shaft
      ? `A peak at one shaft period indicates sidebands spaced by the shaft speed (${hertz(shaft)}).`
      : "The shaft speed of this record is unknown, so no period is marked.",
    summary: `${["Cepstrum", ...places].join(", ")}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      xaxis: { title: { text: "Quefrency (ms)" }, range: [0, x.at(-1)] },
      yaxis: { title: { text: "Real cepstrum (–)" }, range: [1.15 * low, 1.25 * high || 1] },
      shapes: shown.map(({ period }) => verticalLine(period, colour.reference, "dot")),
      annotations: shown.map(({ name, period }, index) => ({
        x: period,
        yref: "paper",
        y: 1 - 0.09 * index,
        yanchor: "top",
        xanchor: "left",
        xshift: 3,
        text: name,
        showarrow: false,
        bgcolor: colour.surface,
        font: { color: colour.reference },
      })),
    },
  };
}
