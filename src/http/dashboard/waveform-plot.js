// Samples over time, down to single ones.

import { clock, count, number, span, titled, unit } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";

const FEW = 400; // up to this many samples, each is a point of its own

function curve({ data: { time_s: x, value: y, unit: unitName, reduced }, colour, pointed }) {
  const mode = !reduced && x.length <= FEW ? "lines+markers" : "lines";
  const hovertemplate = `${pointed}%{x:.5f} s: %{y:.4g} ${unit(unitName)}<extra></extra>`;
  return { x, y, mode, line: { color: colour, width: 1 }, marker: { size: 4 }, hovertemplate };
}

/**
 * Draws waveforms; `range` is the visible part, null for the whole of the longest record, `duration`.
 * @param {import("./layers.js").Layer[]} layers
 */
export function waveformDrawing(layers, range, duration, revision) {
  const [{ data: wave }, ...others] = layers;
  const shown = range ?? [0, duration];
  const part = range ? `${number(shown[0], 5)} to ${number(shown[1], 5)} s` : `All ${number(duration, 4)} s`;
  const detail = layers.some(({ data }) => data.reduced)
    ? "minimum and maximum of each interval; zoom in for every sample"
    : `every sample (${count(wave.time_s.length)})`;
  return {
    traces: [curve(layers[0])],
    others: others.map(curve),
    table: () =>
      recordColumns(layers, (data) => [
        ["time_s", data.time_s],
        [`value (${data.unit})`, data.value],
      ]),
    legend: recordEntries(layers),
    sub: `${part}: ${detail}. Drag to zoom, double-click to reset.`,
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
