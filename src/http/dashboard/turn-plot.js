// The average over one turn of the driving shaft, and its cepstrum's companion: what repeats with each turn.

import { count, number, titled, unit } from "./format.js";
import { palette } from "./plots.js";

const PARTS = [
  ["average", "average over the turns"],
  ["residual", "residual, without the regular mesh"],
  ["mesh_envelope", "envelope of the first mesh line"],
];

function angleWords({ source, harmonic, angle_error_deg: error, pulses }) {
  if (source === "tachometer")
    return `angle from ${count(pulses)} tachometer pulses${error == null ? "" : `, within ${number(error, 2)}°`}`;
  if (source === "mesh_phase")
    return `angle from the phase of mesh harmonic ${harmonic}×, steady within ${error < 0.01 ? "0.01" : number(error, 2)}°`;
  return "speed taken to be constant: no line could be followed";
}

/** The drawing of a synchronous average over one turn. */
export function turnDrawing(turn, other, revision) {
  const colour = palette();
  const {
    angle_deg: x,
    unit: unitName,
    teeth: [teeth],
  } = turn;
  const colours = [colour.accent, colour.series[1], colour.series[3]];
  const compared = other && !(other instanceof Error);
  const curves = (of, which) =>
    PARTS.map(([key, name], index) => ({
      x: of.angle_deg,
      y: of[key],
      mode: "lines",
      line: { color: colours[index], width: index ? 1 : 1.6, dash: index === 2 ? "dot" : "solid" },
      hovertemplate: `${which}${name}, %{x:.1f}°: %{y:.4g} ${unit(unitName)}<extra></extra>`,
    }));
  const entries = PARTS.map(([, name], index) => [index === 2 ? "dot" : "line", colours[index], name]);
  return {
    traces: curves(turn, ""),
    others: compared ? curves(other, "pinned record, ") : null,
    legend: entries,
    table: () => [
      ["angle_deg", x],
      ...PARTS.map(([key]) => [`${key} (${unitName})`, turn[key]]),
      ...(compared
        ? [
            ["pinned angle_deg", other.angle_deg],
            [`pinned average (${other.unit})`, other.average],
          ]
        : []),
    ],
    sub: `${count(turn.turns)} turns averaged, ${angleWords(turn.angle)}. One tooth is ${number(360 / teeth, 4)}°: a single bad tooth stands out of the residual once a turn.`,
    summary: `Average over one turn of the driving shaft from ${turn.turns} turns.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      xaxis: { title: { text: "Angle of the driving shaft (°)" }, range: [0, 360], dtick: 45 },
      yaxis: { title: { text: titled("Amplitude", unitName) } },
    },
  };
}
