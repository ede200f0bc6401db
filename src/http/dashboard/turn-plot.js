// The synchronous average over one turn of either gear.

import { count, number, titled, unit } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";
import { palette } from "./plots.js";

const PARTS = [
  ["average", "synchronous average"],
  ["residual", "residual, without the mesh harmonics"],
  ["mesh_envelope", "envelope of the first mesh line"],
];

function angleWords({ source, harmonic, angle_error_deg: error, pulses }) {
  if (source === "tachometer")
    return `angle from ${count(pulses)} tachometer pulses${error == null ? "" : `, accurate to ${number(error, 2)}°`}`;
  if (source === "mesh_phase")
    return `angle from the phase of mesh harmonic ${harmonic}×, accurate to ${error < 0.01 ? "0.01" : number(error, 2)}°`;
  return "constant speed assumed: no line could be tracked";
}

/**
 * Draws synchronous averages over one turn; for several records only the averages.
 * @param {import("./layers.js").Layer[]} layers
 */
export function turnDrawing(layers, revision) {
  const colour = palette();
  const [{ data: turn, isNamed }, ...others] = layers;
  const { unit: unitName, gear } = turn;
  const gearName = gear === 2 ? "driven gear" : "driving gear";
  const colours = [colour.accent, colour.series[1], colour.series[3]];
  const parts = isNamed ? PARTS.slice(0, 1) : PARTS;
  const curves = ({ data, colour: own, pointed }) =>
    parts.map(([key, name], index) => ({
      x: data.angle_deg,
      y: data[key],
      mode: "lines",
      line: {
        color: isNamed ? own : colours[index],
        width: index ? 1 : 1.6,
        dash: index === 2 ? "dot" : "solid",
      },
      hovertemplate: `${pointed}${name}, %{x:.1f}°: %{y:.4g} ${unit(data.unit)}<extra></extra>`,
    }));
  return {
    traces: curves(layers[0]),
    others: others.flatMap(curves),
    legend: isNamed
      ? recordEntries(layers)
      : PARTS.map(([, name], index) => [index === 2 ? "dot" : "line", colours[index], name]),
    table: () =>
      recordColumns(layers, (data) => [
        [`gear_${gear}_angle_deg`, data.angle_deg],
        ...PARTS.map(([key]) => [`${key} (${data.unit})`, data[key]]),
      ]),
    sub: `${count(turn.turns)} turns of the ${gearName} averaged, ${angleWords(turn.angle)}. One tooth is ${number(360 / turn.teeth[gear - 1], 4)}°: a single damaged tooth shows once per turn in the residual.`,
    summary: `Average over one turn of the ${gearName} from ${turn.turns} turns.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      xaxis: { title: { text: `Angle of the ${gearName} (°)` }, range: [0, 360], dtick: 45 },
      yaxis: { title: { text: titled("Amplitude", unitName) } },
    },
  };
}
