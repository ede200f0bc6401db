// Features of a record as changes since the baseline, beside what the library expects of the estimated wear.

import { depth, featureName, number } from "./format.js";
import { palette } from "./plots.js";

const KINDS = ["ln_mesh", "ln_sideband", "ln_env", "ln_rms", "ln_kurtosis"];
const place = ({ name }) => KINDS.findIndex((kind) => name.startsWith(kind)) * 100 + Number(/\d+$/.exec(name)?.[0] ?? 0);

/** The drawing of measured and expected changes in dB. */
export function featureDrawing({ features, wear_um: wear, interval_um: [low, high], baseline_records: records }, revision) {
  const colour = palette();
  const rows = [...features].sort((a, b) => place(a) - place(b));
  const y = rows.map((row) => featureName(row.name));
  const expected = rows.filter((row) => row.expected_db != null);
  const words = (row) => `${featureName(row.name)}: measured ${number(row.measured_db, 3)} dB ± ${number(2 * row.scatter_db, 2)}, expected ${row.expected_db == null ? "–" : `${number(row.expected_db, 3)} dB`}${row.above_noise ? "" : ", in the noise when healthy: left out"}`;
  const point = (filter, symbol, name) => {
    const some = rows.filter(filter);
    return {
      name,
      x: some.map((row) => row.measured_db),
      y: some.map((row) => featureName(row.name)),
      mode: "markers",
      marker: { symbol, size: 9, color: colour.ink, line: { width: 1.5, color: colour.ink } },
      error_x: { type: "data", array: some.map((row) => 2 * row.scatter_db), color: colour.muted, thickness: 1, width: 3 },
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
      { x: expected.map((row) => row.expected_db), y: expected.map((row) => featureName(row.name)), mode: "markers", marker: { symbol: "line-ns-open", size: 15, color: colour.accent, line: { width: 3, color: colour.accent } }, hoverinfo: "skip" },
      point((row) => row.above_noise, "diamond", "measured"),
      point((row) => !row.above_noise, "diamond-open", "in the noise"),
    ],
    legend: [
      ["band", colour.band, `library, ${depth(low)} to ${depth(high)} µm`],
      ["line", colour.accent, `library at ${depth(wear)} µm`],
      ["diamond", colour.ink, "measured ± 2 standard deviations; hollow: in the noise when healthy, left out"],
    ],
    table: () => [["feature", rows.map((row) => row.name)], ["measured_db", rows.map((row) => row.measured_db)], ["scatter_db", rows.map((row) => row.scatter_db)], ["expected_db", rows.map((row) => row.expected_db)], ["above_noise", rows.map((row) => row.above_noise)]],
    sub: `Amplitudes against the mean of the first ${records} records. Diamonds inside their bars agree with the model.`,
    summary: rows.map(words).join("; "),
    layout: {
      uirevision: revision,
      hovermode: "closest",
      barmode: "overlay",
      xaxis: { title: { text: "Change since the baseline (dB)" }, zeroline: true, zerolinecolor: colour.edge },
      yaxis: { autorange: "reversed", type: "category", categoryorder: "array", categoryarray: y, ticks: "", dtick: 1 },
    },
  };
}
