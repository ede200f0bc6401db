// The plots of a preview: mesh stiffness, transmission error, waveform, spectrum and mesh harmonics, worn and
// unworn.

import { decibels, depth, number } from "./format.js";
import { palette } from "./plots.js";
import { translucent } from "./theme.js";

const SHOWN_PERIODS = 16; // mesh periods of the waveform shown; the saved file has all
const FLOOR_DB = -60; // dB below the strongest line at which the plot ends

/** Extra width of a range that has to grow, so that it rarely does. */
const AHEAD = 0.5;

/** Keeps an axis as wide as it was since the last `reset`, so that curves move and axes do not. */
export class Extents {
  #key;
  #ranges = new Map();

  /** What the ranges belong to. */
  get key() {
    return this.#key;
  }

  /** Forgets the ranges when `key` changes; returns whether it did. */
  reset(key) {
    if (key === this.#key) return false;
    this.#ranges.clear();
    this.#key = key;
    return true;
  }

  /** Extends the ranges to all curves of a model. */
  include(model) {
    for (const plot of [harmonicsPlot, spectrumPlot, waveformPlot, stiffnessPlot, transmissionPlot])
      plot(model, this);
  }

  /** The range of an axis with these values and a margin. */
  of(name, values) {
    const known = this.#ranges.get(name);
    let [low, high] = known ?? [Infinity, -Infinity];
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (known && low < known[0]) low -= AHEAD * (known[0] - low);
    if (known && high > known[1]) high += AHEAD * (high - known[1]);
    this.#ranges.set(name, [low, high]);
    const margin = 0.06 * (high - low || Math.abs(high) || 1);
    return [low - margin, high + margin];
  }
}

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const peakToPeak = (values) => Math.max(...values) - Math.min(...values);

function curves({ unworn, worn, wear_um: wear }, read, hover) {
  const colour = palette();
  const curve = (state, line) => ({ ...read(state), mode: "lines", line, hovertemplate: hover });
  const isWorn = wear > 0;
  return {
    traces: [
      curve(unworn, { color: colour.muted, width: 1.4, ...(isWorn && { dash: "dash" }) }),
      ...(isWorn ? [curve(worn, { color: colour.accent, width: 2 })] : []),
    ],
    legend: [
      [isWorn ? "dash" : "line", colour.muted, "unworn"],
      ...(isWorn ? [["line", colour.accent, `${depth(wear)} µm`]] : []),
    ],
  };
}

/** `least` is the finest difference shown: below it there is only rounding. */
function overMesh(model, extents, { key, scale, title, unit, sub, least = 0 }) {
  const { unworn, worn } = model;
  const read = (of) => ({
    x: of.phi1_rad.map((radian) => 1000 * (radian - of.phi1_rad[0])),
    y: of[key].map((value) => (Math.abs(value * scale) < least ? 0 : value * scale)),
  });
  const { traces, legend } = curves(model, read, `%{x:.1f} mrad: %{y:.4g} ${unit}<extra></extra>`);
  return {
    traces,
    legend,
    sub,
    table: () => [
      ["phi1_rad", worn.phi1_rad],
      [key, worn[key]],
      [`unworn ${key}`, unworn[key]],
      ["pairs_in_contact", worn.pairs_in_contact],
    ],
    summary: `${title} over one mesh period at ${depth(model.wear_um)} µm wear. ${sub}`,
    layout: {
      hovermode: "closest",
      xaxis: { title: { text: "Rotation of the driving gear (mrad)" } },
      yaxis: {
        title: { text: `${title} (${unit})` },
        range: extents.of(
          key,
          traces.flatMap(({ y }) => y),
        ),
      },
    },
  };
}

/** Mesh stiffness over a mesh period. */
export function stiffnessPlot(model, extents) {
  const [before, after] = [model.unworn, model.worn].map(
    ({ stiffness_n_per_m: values }) => mean(values) * 1e-6,
  );
  const sub = `Mean ${number(after, 4)} N/µm, unworn ${number(before, 4)} N/µm.`;
  return overMesh(model, extents, {
    key: "stiffness_n_per_m",
    scale: 1e-6,
    title: "Mesh stiffness",
    unit: "N/µm",
    sub,
  });
}

/** Unloaded transmission error over a mesh period, along the line of action. */
export function transmissionPlot(model, extents) {
  const scale = 1000 * model.base_radius_mm;
  const range = peakToPeak(model.worn.uste_rad) * scale;
  const sub = `Unloaded, ${number(range < 1e-4 ? 0 : range, 3)} µm peak to peak along the line of action.`;
  return overMesh(model, extents, {
    key: "uste_rad",
    scale,
    title: "Transmission error",
    unit: "µm",
    sub,
    least: 1e-4,
  });
}

/** Draws the unworn curve broad and pale behind the worn one, so that differences either way are visible. */
function stand(traces, broad, thin) {
  const [unworn, worn] = traces;
  Object.assign(unworn.line, {
    dash: undefined,
    width: worn ? broad : thin,
    color: worn ? translucent(unworn.line.color, 0.55) : unworn.line.color,
  });
  if (worn) worn.line.width = thin;
}

/** The predicted acceleration. */
export function waveformPlot(model, extents) {
  const read = ({ vibration: { sample_rate_hz: rate, acceleration_m_per_s2: samples } }) => ({
    x: samples.map((_, n) => (1000 * n) / rate),
    y: samples,
  });
  const { traces, legend } = curves(model, read, "%{x:.2f} ms: %{y:.4g} m/s²<extra></extra>");
  stand(traces, 2.5, 1.3);
  const [before, after] = [model.unworn, model.worn].map(({ vibration }) => vibration.rms_m_per_s2);
  const sub = `RMS ${number(after, 3)} m/s², ${decibels(20 * Math.log10(after / before))} dB re unworn. At the driving gear's bearings, without a transmission path.`;
  return {
    traces,
    legend: legend.map(([, colour, words]) => ["line", colour, words]),
    sub,
    table: () => [
      ["time_s", traces[0].x.map((ms) => ms / 1000)],
      ["unworn_m_per_s2", model.unworn.vibration.acceleration_m_per_s2],
      ["worn_m_per_s2", model.worn.vibration.acceleration_m_per_s2],
    ],
    summary: `Expected acceleration at ${depth(model.wear_um)} µm wear. ${sub}`,
    layout: {
      hovermode: "closest",
      xaxis: {
        title: { text: "Time (ms)" },
        range: [0, Math.min(traces[0].x.at(-1), (1000 * SHOWN_PERIODS) / model.mesh_hz)],
      },
      yaxis: {
        title: { text: "Acceleration (m/s²)" },
        range: extents.of(
          "waveform",
          traces.flatMap(({ y }) => y),
        ),
      },
    },
  };
}

/** Amplitudes in dB relative to the largest unworn one, limited to the floor. */
function levels(amplitudes, reference) {
  return amplitudes.map((amplitude) => Math.max(FLOOR_DB, 20 * Math.log10(amplitude / reference)));
}

/** The predicted spectrum. */
export function spectrumPlot(model, extents) {
  const speed = model.shaft_speed_hz;
  const reference = Math.max(...model.unworn.vibration.spectrum_m_per_s2.slice(1));
  const read = ({ vibration: { order_step: step, spectrum_m_per_s2: amplitudes } }) => ({
    x: amplitudes.map((_, n) => n * step * speed),
    y: levels(amplitudes, reference),
  });
  const { traces, legend } = curves(model, read, "%{x:.1f} Hz: %{y:.1f} dB<extra></extra>");
  stand(traces, 4, 1.5);
  const sub = "In dB re the strongest unworn line; shaft sidebands around the mesh harmonics.";
  return {
    traces,
    legend: legend.map(([, colour, words]) => ["line", colour, words]),
    sub,
    table: () => [
      ["frequency_hz", traces[0].x],
      ["unworn_m_per_s2", model.unworn.vibration.spectrum_m_per_s2],
      ["worn_m_per_s2", model.worn.vibration.spectrum_m_per_s2],
    ],
    summary: `Expected spectrum at ${depth(model.wear_um)} µm wear. ${sub}`,
    layout: {
      hovermode: "closest",
      xaxis: { title: { text: "Frequency (Hz)" }, range: [0, traces[0].x.at(-1)] },
      yaxis: {
        title: { text: "Level (dB)" },
        range: [
          FLOOR_DB,
          extents.of(
            "spectrum",
            traces.flatMap(({ y }) => y),
          )[1],
        ],
      },
    },
  };
}

/** The change of each mesh harmonic. */
export function harmonicsPlot({ harmonics, wear_um: wear, mesh_hz: mesh }, extents) {
  const colour = palette();
  const changes = harmonics.map(({ change_db: change }) => change);
  const strongest = harmonics.reduce((most, line) =>
    Math.abs(line.change_db) > Math.abs(most.change_db) ? line : most,
  );
  const sub =
    wear > 0
      ? `Largest change at ${strongest.harmonic}×: ${decibels(strongest.change_db)} dB. Mesh frequency ${number(mesh, 5)} Hz.`
      : `Unworn: no change. Mesh frequency ${number(mesh, 5)} Hz.`;
  return {
    traces: [
      {
        type: "bar",
        x: harmonics.map(({ harmonic }) => `${harmonic}×`),
        y: changes,
        marker: { color: changes.map((change) => (change >= 0 ? colour.accent : colour.other)) },
        customdata: harmonics.map(({ frequency_hz: frequency, worn_m_per_s2: amplitude }) => [
          frequency,
          amplitude,
        ]),
        hovertemplate: "%{customdata[0]:.1f} Hz: %{y:+.1f} dB, %{customdata[1]:.3g} m/s²<extra></extra>",
      },
    ],
    legend: [
      ["band", colour.accent, "grown"],
      ["band", colour.other, "shrunk"],
    ],
    sub,
    table: () => [
      ["harmonic", harmonics.map(({ harmonic }) => harmonic)],
      ["frequency_hz", harmonics.map((line) => line.frequency_hz)],
      ["unworn_m_per_s2", harmonics.map((line) => line.unworn_m_per_s2)],
      ["worn_m_per_s2", harmonics.map((line) => line.worn_m_per_s2)],
      ["change_db", changes],
    ],
    summary: `Change of the mesh harmonics at ${depth(wear)} µm wear. ${sub}`,
    layout: {
      bargap: 0.35,
      xaxis: { title: { text: "Mesh harmonic" }, type: "category" },
      yaxis: {
        title: { text: "Change (dB)" },
        range: extents.of("harmonics", [-3, 6, ...changes]),
        zeroline: true,
        zerolinewidth: 1.5,
      },
    },
  };
}
