// Scope, spectrum and level of a live stream.

import { clock, hertz, number, titled, unit } from "./format.js";
import { svg } from "./dom.js";
import { palette, verticalLine } from "./plots.js";

const HARMONICS = 20; // mesh lines that are marked
const NAMED = 10;
const NAME_PX = 30;

/** `[x, y]` of a channel's scope: seconds before the last sample. */
export function scopeLine(frame, channel) {
  const { scope_samples: samples, sample_rate_hz: rate } = frame;
  return [channel.scope_index.map((index) => (index - (samples - 1)) / rate), channel.scope];
}

/** `[x, y]` of a channel's spectrum; in shaft orders if requested and the speed is known. */
export function spectrumLine(frame, channel, inOrders) {
  const step = frame.resolution_hz / (inOrders ? frame.shaft_speed_hz : 1);
  return [channel.bin.map((bin) => bin * step), channel.amplitude];
}

/**
 * `[x, y]` of a record's spectrum for comparison; null when orders are requested and its speed is unknown.
 */
export function recordLine(spectrum, inOrders) {
  const shaft = inOrders ? spectrum.shaft_speed_hz : 1;
  return shaft ? [spectrum.frequency_hz.map((hz) => hz / shaft), spectrum.amplitude] : null;
}

/** Draws a scope; `range` is its value range. */
export function scopeDrawing(frame, channel, range) {
  const colour = palette();
  const [x, y] = scopeLine(frame, channel);
  const length = frame.scope_samples / frame.sample_rate_hz;
  return {
    traces: [
      {
        x,
        y,
        mode: "lines",
        line: { color: colour.accent, width: 1 },
        hovertemplate: `%{x:.4f} s: %{y:.4g} ${unit(frame.unit)}<extra></extra>`,
      },
    ],
    sub: `The last ${number(length, 3)} s, as minimum and maximum of each interval.`,
    summary: `Samples of channel ${channel.name} over the last ${number(length, 3)} s.`,
    table: () => [
      ["time_s", x],
      [`value (${frame.unit})`, y],
    ],
    layout: {
      uirevision: `scope ${channel.name} ${length}`,
      hovermode: "closest",
      xaxis: { title: { text: "Time before the last sample (s)" }, range: [-length, 0] },
      yaxis: { title: { text: titled("Amplitude", frame.unit) }, range: [...range] },
    },
  };
}

/** Mesh lines with labels at the top, where they cover no peak. */
function meshMarks(spacing, end, colour) {
  const orders = Array.from({ length: HARMONICS }, (_, n) => n + 1).filter((order) => order * spacing <= end);
  // Only every n-th line is labelled when there is no space for all
  const step = Math.ceil((NAME_PX * end) / (spacing * 0.85 * Math.min(innerWidth, 1400)));
  const annotations = orders
    .filter((order) => order <= NAMED && (order - 1) % step === 0)
    .map((order) => ({
      x: order * spacing,
      yref: "paper",
      y: 1,
      yanchor: "top",
      text: `${order}×`,
      showarrow: false,
      borderpad: 0,
      bgcolor: colour.surface,
      font: { color: colour.reference },
    }));
  return {
    shapes: orders.map((order) => verticalLine(order * spacing, colour.reference, "dot")),
    annotations,
  };
}

/**
 * Draws a spectrum; `record` is `{ spectrum, segment }` to compare with, or null; `range` is the amplitude
 * range (in decades on a log scale).
 */
export function liveSpectrumDrawing(frame, channel, record, { inOrders, logarithmic, range }) {
  const colour = palette();
  const { shaft_speed_hz: shaft, mesh_frequency_hz: mesh, resolution_hz: step } = frame;
  const per = inOrders ? shaft : 1;
  const [x, y] = spectrumLine(frame, channel, inOrders);
  const end = frame.sample_rate_hz / 2 / per;
  const suffix = inOrders ? ". order" : " Hz";
  const hover = (which) => `${which}%{x:.2f}${suffix}: %{y:.4g} ${unit(frame.unit)}<extra></extra>`;
  const compared = record && recordLine(record.spectrum, inOrders);
  const ours = { x, y, mode: "lines", line: { color: colour.accent, width: 1 }, hovertemplate: hover("") };
  const theirs = compared && {
    x: compared[0],
    y: compared[1],
    mode: "lines",
    line: { color: colour.other, width: 1 },
    hovertemplate: hover("record, "),
  };
  const marks = mesh ? meshMarks(mesh / per, end, colour) : { shapes: [], annotations: [] };
  const legend = mesh
    ? [
        [
          "dot",
          colour.reference,
          `mesh ${inOrders ? `at order ${number(mesh / per)}` : hertz(mesh)} and harmonics`,
        ],
      ]
    : [];
  if (compared)
    legend.unshift(
      ["line", colour.accent, "live"],
      ["line", colour.other, `record of ${clock(record.segment.start_time)}`],
    );
  const beside = compared
    ? ` Record: lines every ${hertz(record.spectrum.resolution_hz)}; closer lines have a lower noise floor.`
    : "";
  const none = shaft ? "" : "The shaft speed is unknown, so mesh lines are not marked. ";
  return {
    // The record's line is drawn first, behind the stream's
    traces: compared ? [theirs, ours] : [ours],
    legend,
    sub: `${none}Hann window over ${number(frame.samples / frame.sample_rate_hz, 3)} s, lines every ${hertz(step)}, peaks preserved.${beside}`,
    summary: `Amplitude spectrum of channel ${channel.name}, live.`,
    table: () => [
      [inOrders ? "order" : "frequency_hz", x],
      [`amplitude_peak (${frame.unit})`, y],
    ],
    layout: {
      uirevision: `spectrum ${channel.name} ${inOrders} ${frame.sample_rate_hz}`,
      hovermode: "closest",
      xaxis: {
        title: { text: inOrders ? "Order of the driving shaft (–)" : "Frequency (Hz)" },
        range: [0, end],
        exponentformat: "none",
      },
      yaxis: {
        title: { text: titled("Peak amplitude", frame.unit) },
        type: logarithmic ? "log" : "linear",
        range: [...range],
        uirevision: `spectrum ${channel.name} ${logarithmic}`,
        ...(logarithmic && { dtick: 1, exponentformat: "power" }),
      },
      ...marks,
    },
  };
}

const [WIDTH, HEIGHT] = [600, 60];

/** The running level: `update([{ at, rms, peak }])`, with times in ms, draws the last `seconds`. */
export class LevelTrend {
  #rms = svg("path", { class: "level-rms" });
  #peak = svg("path", { class: "level-peak" });
  #seconds;
  element = svg(
    "svg",
    {
      class: "level-trend",
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
      preserveAspectRatio: "none",
      role: "img",
      "aria-label": "RMS and peak over the last minute",
    },
    this.#peak,
    this.#rms,
  );

  constructor(seconds) {
    this.#seconds = seconds;
  }

  /** Draws levels; the latest is at the right edge. */
  update(levels) {
    const now = levels.at(-1)?.at ?? 0;
    const top = Math.max(...levels.map(({ peak }) => peak), Number.MIN_VALUE);
    const path = (key) => {
      const points = levels
        .filter((level) => Number.isFinite(level[key]))
        .map(
          (level) =>
            `${(WIDTH * (1 - (now - level.at) / (1000 * this.#seconds))).toFixed(1)} ${(HEIGHT - 2 - (HEIGHT - 4) * (level[key] / top)).toFixed(1)}`,
        );
      return points.length > 1 ? `M${points.join("L")}` : "";
    };
    this.#rms.setAttribute("d", path("rms"));
    this.#peak.setAttribute("d", path("peak"));
  }
}
