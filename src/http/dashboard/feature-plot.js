// Feature changes since the baseline, compared with the library's prediction for the estimated wear.

import { AGREEMENT_RULE, agrees, counts, whisker } from "./agreement.js";
import { depth, featureName, number } from "./format.js";
import { palette } from "./plots.js";

const KINDS = ["ln_mesh", "ln_sideband", "ln_env", "ln_rms", "ln_kurtosis"];
const place = ({ name }) =>
  KINDS.findIndex((kind) => name.startsWith(kind)) * 100 + Number(/\d+$/.exec(name)?.[0] ?? 0);

/** The drawing of measured and expected changes in dB. */
export function featureDrawing(
  { features, wear_um: wear, interval_um: [low, high], baseline_records: records },
  revision,
) {
  const colour = palette();
  const rows = [...features].sort((a, b) => place(a) - place(b));
  const y = rows.map((row) => featureName(row.name));
  const expected = rows.filter((row) => row.expected_db != null);
  const words = (row) =>
    `${featureName(row.name)}: measured ${number(row.measured_db, 3)} dB ± ${number(whisker(row), 2)}, expected ${row.expected_db == null ? "–" : `${number(row.expected_db, 3)} dB`}${row.above_noise ? (counts(row) ? (agrees(row) ? ": agrees" : ": disagrees") : "") : ", in the noise when healthy: not used"}`;
  const odd = (row) => counts(row) && !agrees(row);
  const point = (filter, symbol, name, ink) => {
    const some = rows.filter(filter);
    return {
      name,
      x: some.map((row) => row.measured_db),
      y: some.map((row) => featureName(row.name)),
      mode: "markers",
      marker: { symbol, size: 9, color: ink, line: { width: 1.5, color: ink } },
      error_x: { type: "data", array: some.map(whisker), color: colour.muted, thickness: 1, width: 3 },
      customdata: some.map(words),
      hovertemplate: "%{customdata}<extra></extra>",
    };
  };
  return {
    traces: [
      {
        type: "bar",
        orientation: "h",
        base: expected.map((row) => row.expected_interval_db[0]),
        x: expected.map((row) => Math.max(row.expected_interval_db[1] - row.expected_interval_db[0], 0.05)),
        y: expected.map((row) => featureName(row.name)),
        marker: { color: colour.band },
        width: 0.8,
        hoverinfo: "skip",
      },
      {
        x: expected.map((row) => row.expected_db),
        y: expected.map((row) => featureName(row.name)),
        mode: "markers",
        marker: {
          symbol: "line-ns-open",
          size: 15,
          color: colour.accent,
          line: { width: 3, color: colour.accent },
        },
        hoverinfo: "skip",
      },
      point((row) => row.above_noise && !odd(row), "diamond", "measured", colour.ink),
      point(odd, "x", "disagrees", colour.danger),
      point((row) => !row.above_noise, "diamond-open", "in the noise", colour.ink),
    ],
    legend: [
      ["band", colour.band, `library, ${depth(low)} to ${depth(high)} µm`],
      ["line", colour.accent, `library at ${depth(wear)} µm`],
      ["filled", colour.ink, "measured, with its whisker"],
      ...(rows.some(odd) ? [["cross", colour.danger, "measured, disagrees"]] : []),
      ...(rows.some((row) => !row.above_noise)
        ? [["diamond", colour.ink, "in the noise when healthy: not used"]]
        : []),
    ],
    table: () => [
      ["feature", rows.map((row) => row.name)],
      ["measured_db", rows.map((row) => row.measured_db)],
      ["scatter_db", rows.map((row) => row.scatter_db)],
      ["expected_db", rows.map((row) => row.expected_db)],
      ["above_noise", rows.map((row) => row.above_noise)],
    ],
    sub: `Amplitudes relative to the mean of the first ${records} records. ${AGREEMENT_RULE}.`,
    summary: rows.map(words).join("; "),
    layout: {
      uirevision: revision,
      hovermode: "closest",
      barmode: "overlay",
      xaxis: {
        title: { text: "Change since the baseline (dB)" },
        zeroline: true,
        zerolinecolor: colour.edge,
      },
      yaxis: {
        autorange: "reversed",
        type: "category",
        categoryorder: "array",
        categoryarray: y,
        ticks: "",
        dtick: 1,
      },
    },
  };
}
