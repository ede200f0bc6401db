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

const nameOf = ({ gear }) => (gear === 2 ? "driven gear" : "driving gear");
const GAP = 0.2; // between the averages of both gears, as a fraction of the plot

/** The averages in a record's data, one or those of both gears. */
const gearsOf = (data) => (data.driven ? [data, data.driven] : [data]);

function words(turn) {
  const tooth = turn.teeth ? ` One tooth is ${number(360 / turn.teeth[turn.gear - 1], 4)}°.` : "";
  return `${count(turn.turns)} turns of the ${nameOf(turn)} averaged, ${angleWords(turn.angle)}.${tooth}`;
}

/** The axes of one average, or of both above one another: the gears turn at different speeds. */
function axesOf(gears, unitName) {
  const height = (1 - GAP * (gears.length - 1)) / gears.length;
  const axes = gears.map((turn, row) => {
    const [suffix, top] = [row ? String(row + 1) : "", 1 - row * (height + GAP)];
    const title = { text: `Angle of the ${nameOf(turn)} (°)`, standoff: 8 };
    return {
      [`xaxis${suffix}`]: { title, range: [0, 360], dtick: 45, anchor: `y${suffix}` },
      [`yaxis${suffix}`]: {
        title: { text: titled("Amplitude", unitName) },
        domain: [Math.max(0, top - height), top],
        anchor: `x${suffix}`,
        ...(row && { matches: "y" }),
      },
    };
  });
  return Object.assign({}, ...axes);
}

/**
 * Draws synchronous averages over one turn; for several records only the averages.
 * @param {import("./layers.js").Layer[]} layers
 */
export function turnDrawing(layers, revision) {
  const colour = palette();
  const [{ data: turn, isNamed }] = layers;
  const gears = gearsOf(turn);
  const isBoth = gears.length > 1;
  const colours = [colour.accent, colour.series[1], colour.series[3]];
  const parts = isNamed || (isBoth && layers.length > 1) ? PARTS.slice(0, 1) : PARTS;
  const isByRecord = parts.length === 1;
  const curves = ({ data, colour: own, pointed }) =>
    gearsOf(data).flatMap((each, row) =>
      parts.map(([key, name], index) => ({
        x: each.angle_deg,
        y: each[key],
        mode: "lines",
        line: {
          color: isByRecord ? own : colours[index],
          width: index ? 1 : 1.6,
          dash: index === 2 ? "dot" : "solid",
        },
        ...(row && { xaxis: "x2", yaxis: "y2" }),
        hovertemplate: `${pointed}${name}, %{x:.1f}° of the ${nameOf(each)}: %{y:.4g} ${unit(each.unit)}<extra></extra>`,
      })),
    );
  const [first, ...others] = layers.map(curves);
  return {
    // Both gears take the rows in which a pinned record would be compared
    traces: isBoth ? [...others.flat(), ...first] : first,
    others: isBoth ? [] : others.flat(),
    isCompared: isBoth,
    legend: isByRecord
      ? recordEntries(layers)
      : PARTS.map(([, name], index) => [index === 2 ? "dot" : "line", colours[index], name]),
    table: () =>
      recordColumns(layers, (data) =>
        gearsOf(data).flatMap((each) => [
          [`gear_${each.gear}_angle_deg`, each.angle_deg],
          ...PARTS.map(([key]) => [`${isBoth ? `gear_${each.gear}_` : ""}${key} (${each.unit})`, each[key]]),
        ]),
      ),
    sub: `${gears.map(words).join(" ")} A single damaged tooth shows once per turn of its gear in the residual.`,
    summary: gears
      .map((each) => `Average over one turn of the ${nameOf(each)} from ${each.turns} turns.`)
      .join(" "),
    layout: { uirevision: revision, hovermode: "closest", ...axesOf(gears, turn.unit) },
  };
}
