// Samples over time, down to the single one.

import { count, number, span, titled, unit, utc } from "./format.js";
import { palette } from "./plots.js";

const FEW = 400; // from here on each sample is a point of its own

function curve({ time_s: x, value: y, unit: unitName, reduced }, colour, which) {
  const mode = !reduced && x.length <= FEW ? "lines+markers" : "lines";
  const hovertemplate = `${which}%{x:.5f} s: %{y:.4g} ${unit(unitName)}<extra></extra>`;
  return { x, y, mode, line: { color: colour, width: 1 }, marker: { size: 4 }, hovertemplate };
}

/** The drawing of a waveform; `range` is the part that is looked at, null for the whole record. */
export function waveformDrawing(wave, other, range, duration, revision) {
  const colour = palette();
  const traces = [curve(wave, colour.accent, "")];
  const compared = other && !(other instanceof Error);
  const shown = range ?? [0, duration];
  const part = range ? `${number(shown[0], 5)} to ${number(shown[1], 5)} s` : `All ${number(duration, 4)} s`;
  const detail = wave.reduced
    ? "drawn by the lowest and highest sample of each stretch; zoom in for every sample"
    : `every sample, ${count(wave.time_s.length)} of them`;
  return {
    traces,
    others: compared ? [curve(other, colour.other, "pinned record, ")] : null,
    table: () => [
      ["time_s", wave.time_s],
      [`value (${wave.unit})`, wave.value],
      ...(compared
        ? [
            ["pinned time_s", other.time_s],
            [`pinned value (${other.unit})`, other.value],
          ]
        : []),
    ],
    legend: compared
      ? [
          ["line", colour.accent, "selected record"],
          ["line", colour.other, "pinned record"],
        ]
      : [],
    sub: `${part}: ${detail}. Drag to zoom, double-click for the whole.`,
    summary: `Waveform from ${utc(wave.start_time)}, ${span(duration)} long: ${part}.`,
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
