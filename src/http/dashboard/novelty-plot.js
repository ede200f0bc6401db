// The features of a record that deviate most from the best wear state.

import { featureName, number } from "./format.js";
import { lastingWords, unexplained } from "./match-words.js";
import { palette } from "./plots.js";

const DB = 20 / Math.LN10;
const NOTABLE = 2; // novelty of one healthy record in a hundred

/** Draws the features that deviate most, in dB: from the best wear state, or without a pair from the baseline. */
export function noveltyDrawing(novelty, revision, hasPair) {
  const { largest_deviations: largest, p_value: probability, score } = novelty;
  const named = [unexplained(novelty), lastingWords(novelty)]
    .filter(Boolean)
    .map((words) => `${words[0].toUpperCase()}${words.slice(1)}.`)
    .join(" ");
  const likely = probability > 0.99 ? "> 0.99" : number(probability, 2);
  const causes =
    score >= NOTABLE ? "Possible causes: a bearing fault, a loose mount, a changed load." : "This is usual.";
  const colour = palette();
  const names = largest.map(({ feature }) => featureName(feature));
  const decibels = largest.map(({ ln_ratio: ratio }) => ratio * DB);
  const words = largest.map(
    ({ deviations }, n) =>
      `${decibels[n] > 0 ? "+" : "−"}${number(Math.abs(decibels[n]), 3)} dB, ${number(Math.abs(deviations), 2)} σ`,
  );
  const reach = 1.5 * Math.max(1, ...decibels.map(Math.abs));
  return {
    traces: [
      {
        type: "bar",
        orientation: "h",
        x: decibels,
        y: names,
        text: words,
        textposition: "outside",
        cliponaxis: false,
        textfont: { color: colour.ink },
        marker: { color: colour.series[1] },
        width: 0.5,
        hoverinfo: "skip",
      },
    ],
    legend: [],
    title: hasPair ? "Largest deviations not explained by wear" : "Largest deviations from the baseline",
    table: () => [
      ["feature", largest.map(({ feature }) => feature)],
      ["db", decibels],
      ["standard_deviations", largest.map(({ deviations }) => deviations)],
    ],
    sub: `Probability of such a record ${hasPair ? "in the best state" : "in the baseline"}: ${likely} (novelty ${number(score, 3)}). ${named || causes}`,
    summary: names.map((name, n) => `${name}: ${words[n]}`).join("; "),
    layout: {
      uirevision: revision,
      xaxis: {
        title: { text: `Measured relative to the ${hasPair ? "expected amplitude" : "baseline"} (dB)` },
        range: [Math.min(0, ...decibels) < 0 ? -reach : 0, Math.max(0, ...decibels) > 0 ? reach : 0],
        zeroline: true,
        zerolinecolor: colour.edge,
      },
      yaxis: { autorange: "reversed", type: "category", ticks: "" },
    },
  };
}
