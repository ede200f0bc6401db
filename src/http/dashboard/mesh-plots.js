// Stiffness and transmission error over one mesh period, worn and unworn.

import { depth, number } from "./format.js";
import { palette } from "./plots.js";

/** µm along the line of action for a radian of the driven gear. */
export function umPerRadian({ teeth, module_mm: module, pressure_angle_deg: angle }) {
  const baseRadius_mm = 0.5 * module * teeth[1] * Math.cos((angle * Math.PI) / 180);
  return 1000 * baseRadius_mm;
}

function drawing(state, unworn, { key, scale, title, unit }, revision) {
  const colour = palette();
  const curve = (of, line) => ({
    x: of.phi1_rad.map((radian) => 1000 * (radian - of.phi1_rad[0])),
    y: of[key].map((value) => value * scale),
    mode: "lines",
    line,
    hovertemplate: `%{x:.1f} mrad: %{y:.4g} ${unit}<extra></extra>`,
  });
  const worn = state.index > 0;
  const mean = (values) => (values.reduce((sum, value) => sum + value, 0) / values.length) * scale;
  const shown = (value) => number(Math.abs(value) < 1e-6 ? 0 : value, 4); // rounding noise is shown as zero
  return {
    traces: [
      curve(unworn, { color: colour.muted, width: 1.5, dash: "dash" }),
      ...(worn ? [curve(state, { color: colour.accent, width: 2 })] : []),
    ],
    legend: [
      ["dash", colour.muted, "unworn"],
      ...(worn ? [["line", colour.accent, `state ${state.index}, ${depth(state.wear_um)} µm`]] : []),
    ],
    table: () => [
      ["phi1_rad", state.phi1_rad],
      [key, state[key]],
      [`unworn ${key}`, unworn[key]],
      ["pairs_in_contact", state.pairs_in_contact],
    ],
    sub: `Over one mesh period; the mean is ${shown(mean(state[key]))} ${unit}, unworn ${shown(mean(unworn[key]))} ${unit}.`,
    summary: `${title} over one mesh period at ${depth(state.wear_um)} µm wear.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      xaxis: { title: { text: "Rotation of the driving gear (mrad)" } },
      yaxis: { title: { text: `${title} (${unit})` } },
    },
  };
}

/** Mesh stiffness of a state and of the unworn one. */
export function stiffnessDrawing(state, unworn, revision) {
  return drawing(
    state,
    unworn,
    { key: "stiffness_n_per_m", scale: 1e-6, title: "Mesh stiffness", unit: "N/µm" },
    revision,
  );
}

/** Unloaded static transmission error of a state and of the unworn one, along the line of action. */
export function transmissionDrawing(state, unworn, geometry, revision) {
  return drawing(
    state,
    unworn,
    { key: "uste_rad", scale: umPerRadian(geometry), title: "Transmission error", unit: "µm" },
    revision,
  );
}
