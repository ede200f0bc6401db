// Samples over time, down to the single one.

import { clock, count, number, span, titled, unit } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";

const FEW = 400; // from here on each sample is a point of its own

function curve({ data: { time_s: x, value: y, unit: unitName, reduced }, colour, pointed }) {
  const mode = !reduced && x.length <= FEW ? "lines+markers" : "lines";
  const hovertemplate = `${pointed}%{x:.5f} s: %{y:.4g} ${unit(unitName)}<extra></extra>`;
  return { x, y, mode, line: { color: colour, width: 1 }, marker: { size: 4 }, hovertemplate };
}

/**
 * The drawing of waveforms; `range` is the part that is looked at, null for the whole of the longest record, `duration`.
 * @param {import("./layers.js").Layer[]} layers
 */
export function waveformDrawing(layers, range, duration, revision) {
  const [{ data: wave }, ...others] = layers;
  const shown = range ?? [0, duration];
  const part = range ? `${number(shown[0], 5)} to ${number(shown[1], 5)} s` : `All ${number(duration, 4)} s`;
  const detail = layers.some(({ data }) => data.reduced)
    ? "drawn by the lowest and highest sample of each stretch; zoom in for every sample"
    : `every sample, ${count(wave.time_s.length)} of them`;
  return {
    traces: [curve(layers[0])],
    others: others.map(curve),
    table: () =>
      recordColumns(layers, (data) => [
        ["time_s", data.time_s],
        [`value (${data.unit})`, data.value],
      ]),
    legend: recordEntries(layers),
    sub: `${part}: ${detail}. Drag to zoom, double-click for the whole.`,
    summary: `Waveform from ${clock(wave.start_time)}, ${span(duration)} long: ${part}.`,
    layout: {
      uirevision: `${revision} ${wave.segment_id}`,
      hovermode: "closest",
      xaxis: {
        title: { text: "Time since the first sample (s)" },
        range: [...shown],
        uirevision: String(range),
      },
      yaxis: { title: { text: titled("Amplitude", wave.unit) }, uirevision: String(range) },
    },
  };
}
