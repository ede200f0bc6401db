// Amplitude spectrum with mesh lines, and envelope spectrum with shaft lines.

import { amplitudeAxis, height, place } from "./amplitude-scale.js";
import { BEARING_LINES } from "./bearing-geometry.js";
import { amplitudeAt } from "./fine-lines.js";
import { hertz, number, unit } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";
import { changeDrawing } from "./level-change.js";
import { palette, verticalLine } from "./plots.js";

const WINDOWS = {
  hann: "Hann",
  hamming: "Hamming",
  rectangular: "rectangular",
  flattop: "flat-top",
  blackman: "Blackman",
};
const QUANTITIES = {
  amplitude_peak: "Peak amplitude",
  amplitude_rms: "RMS amplitude",
  psd: "Power spectral density",
};

const HERTZ = { title: "Frequency (Hz)", name: "frequency_hz", format: hertz, wide: hertz, suffix: " Hz" };
export const ORDERS = {
  title: "Order of the driving shaft (–)",
  name: "order",
  format: (value) => `order ${number(value, 5)}`,
  wide: (value) => `${number(value, 3)} orders`,
  suffix: ". order",
};

/**
 * Converts an order spectrum to the shape of a frequency spectrum; the axis unit is one order of the driving
 * shaft.
 * @param {Answer<"/v1/segments/{segment}/orders">} orders
 */
export function ofOrders({
  order,
  amplitude,
  mesh_amplitudes: mesh,
  teeth: numbers,
  bandwidth_orders: bandwidth,
  resolution_orders: resolution,
  ...rest
}) {
  const [teeth] = numbers ?? []; // a machine without a mesh has no teeth and no harmonics
  const harmonics = mesh.map((height, index) => ({
    order: index + 1,
    frequency_hz: (index + 1) * teeth,
    amplitude: height,
  }));
  return {
    ...rest,
    axis: ORDERS,
    frequency_hz: order,
    amplitude,
    bandwidth_hz: bandwidth,
    resolution_hz: resolution,
    shaft_speed_hz: 1,
    mesh_frequency_hz: teeth,
    mesh_harmonics: harmonics,
  };
}

/** The horizontal axis of a spectrum. */
export function axisOf(spectrum) {
  return spectrum.axis ?? HERTZ;
}

/**
 * Converts a spectrum over hertz to shaft orders, using the record's mean speed.
 * @param {any} spectrum
 * @param {number} shaft
 */
export function overOrders(spectrum, shaft) {
  const { frequency_hz: x, resolution_hz: step, bandwidth_hz: bandwidth, mesh_frequency_hz: mesh } = spectrum;
  return {
    ...spectrum,
    axis: ORDERS,
    hertz_per_unit: shaft,
    frequency_hz: x.map((hz) => hz / shaft),
    resolution_hz: step / shaft,
    bandwidth_hz: bandwidth / shaft,
    shaft_speed_hz: 1,
    mesh_frequency_hz: mesh && mesh / shaft,
  };
}

/** Window, bandwidth and reduction: what makes two spectra comparable. */
function convention({
  axis: { wide } = HERTZ,
  window,
  bandwidth_hz: bandwidth,
  resolution_hz: resolution,
  reduced,
  part,
}) {
  const name = WINDOWS[window] ?? window;
  const lines = `${name} window, ${wide(bandwidth)} noise bandwidth, lines every ${wide(resolution)}`;
  return (part ?? { reduced }).reduced
    ? `${lines}; reduced for display, peaks preserved`
    : `${lines}, all drawn`;
}

/** The visible amplitudes. */
function visibleOf(layers, [from, to]) {
  return layers.flatMap(({ data: { frequency_hz: x, amplitude } }) =>
    amplitude.filter((_, index) => x[index] >= from && x[index] <= to),
  );
}

/** The amplitude axis for several records, named after the first one. */
function axisOfAmplitudes(layers, range, scale, revision) {
  const [{ data: first }] = layers;
  const title = QUANTITIES[first.quantity] ?? first.quantity;
  return amplitudeAxis(scale, title, first.unit, visibleOf(layers, range), revision);
}

function line({ data, colour, pointed }, scale) {
  const { frequency_hz: x, amplitude, unit: unitName } = data;
  const value = scale === "db" ? "%{y:.1f} dB" : `%{y:.4g} ${unit(unitName)}`;
  return {
    x,
    y: scale === "db" ? amplitude.map((each) => height(scale, each)) : amplitude,
    mode: "lines",
    line: { color: colour, width: 1 },
    hovertemplate: `${pointed}%{x:.2f}${axisOf(data).suffix}: ${value}<extra></extra>`,
  };
}

/** The columns of a saved file; of a zoomed spectrum only its part, as the rest is reduced. */
function columns(spectrum) {
  const { frequency_hz: x, amplitude } = spectrum.part ?? spectrum;
  return [
    [axisOf(spectrum).name, x],
    [`amplitude_peak (${spectrum.unit})`, amplitude],
  ];
}

/** Markers at peaks, with more text on hover. */
function marks(points, colour, scale) {
  return {
    x: points.map((point) => point.frequency_hz),
    y: points.map((point) => height(scale, point.amplitude)),
    mode: "markers",
    cliponaxis: false,
    marker: { symbol: "diamond-open", size: 9, color: colour.reference, line: { width: 2 } },
    customdata: points.map((point) => point.words),
    hovertemplate: "%{customdata}<extra></extra>",
  };
}

/** A label above a marker, with a background so that the marker's line does not strike it through. */
function label({ frequency_hz: x, amplitude, label: text }, colour, scale) {
  return {
    x,
    y: place(scale, amplitude),
    text,
    showarrow: false,
    yshift: 14,
    borderpad: 0,
    bgcolor: colour.surface,
    font: { color: colour.reference },
  };
}

const NUMBER = 0.035; // width of a number as a fraction of the plot
const NARROW_NUMBER = 0.1;
const isNarrow = () => matchMedia("(max-width: 40rem)").matches;

/**
 * The points whose numbers do not touch the one before.
 * @param {any[]} points
 * @param {number[]} range
 */
function apart(points, [from, to]) {
  const width = (isNarrow() ? NARROW_NUMBER : NUMBER) * (to - from);
  let last = -Infinity;
  return points.filter(({ frequency_hz: x }) => {
    const fits = x - last >= width;
    if (fits) last = x;
    return fits;
  });
}

/** A zoom range: the whole spectrum or the surroundings of a mesh line. */
export function zoomRange(spectrum, choice) {
  const order = Number(choice);
  if (!order || !spectrum.mesh_frequency_hz) return null;
  const reach = Math.min(10 * spectrum.shaft_speed_hz, 0.5 * spectrum.mesh_frequency_hz);
  return [order * spectrum.mesh_frequency_hz - reach, order * spectrum.mesh_frequency_hz + reach];
}

/** The sidebands marked around a mesh line. */
export function sidebandsOf(centre, shaft) {
  return [-3, -2, -1, 1, 2, 3].map((k) => ({ x: centre + k * shaft, label: k > 0 ? `+${k}` : `−${-k}` }));
}

/** The sidebands of the mesh lines; numbered only around the zoomed line. */
function sidebandLines(harmonics, shaft, colour, zoom) {
  const shapes = [];
  const annotations = [];
  for (const { order, frequency_hz: centre } of harmonics) {
    for (const { x, label: text } of sidebandsOf(centre, shaft)) {
      shapes.push(verticalLine(x, colour.edge, "dash", 1));
      if (order === Number(zoom))
        annotations.push({
          x,
          yref: "paper",
          y: 1,
          yanchor: "top",
          text,
          showarrow: false,
          bgcolor: colour.surface,
          font: { color: colour.muted },
        });
    }
  }
  return { shapes, annotations };
}

/** The largest end of several spectra. */
const endOf = (layers) => Math.max(...layers.map(({ data }) => data.frequency_hz.at(-1)));

/**
 * Draws the amplitude spectra of records; lines are marked in the first one. `zoom` is "" or the order of a
 * mesh line, `part` the dragged-out range or null, `note` additional text.
 * @param {import("./layers.js").Layer[]} layers
 * @param {{ scale: string, sidebands?: boolean, zoom?: string, part: number[] | null, note?: string, hasMesh?: boolean }} view
 */
export function spectrumDrawing(
  layers,
  { scale, sidebands, zoom, part, note = "", hasMesh = true },
  revision,
) {
  const colour = palette();
  const [{ data: spectrum }, ...others] = layers;
  const axis = axisOf(spectrum);
  if (scale === "change") return changeDrawing(layers, axis, part ?? [0, endOf(layers)], note, revision);
  const { shaft_speed_hz: shaft, mesh_frequency_hz: mesh, mesh_harmonics: harmonics } = spectrum;
  const points = harmonics.map(({ order, frequency_hz: frequency, amplitude }) => ({
    frequency_hz: frequency,
    amplitude,
    label: `${order}×`,
    words: `mesh harmonic ${order}×: ${axis.format(frequency)}, ${number(amplitude)} ${unit(spectrum.unit)}`,
  }));
  const shapes = harmonics.map(({ frequency_hz: frequency }) =>
    verticalLine(frequency, colour.reference, "dot"),
  );
  const range = part ?? zoomRange(spectrum, zoom) ?? [0, endOf(layers)];
  /** @type {any[]} */
  const annotations = apart(points, range).map((point) => label(point, colour, scale));
  const entries = points.length
    ? [["diamond", colour.reference, `mesh harmonics of ${axis.format(mesh)}`]]
    : [];
  if (sidebands && shaft && mesh) {
    const lines = sidebandLines(harmonics, shaft, colour, zoom);
    shapes.push(...lines.shapes);
    annotations.push(...lines.annotations);
    entries.push(["dash", colour.muted, `sidebands ± 1 to 3 × ${axis.format(shaft)} shaft speed`]);
  }
  const axisRevision = `${revision} ${zoom} ${axis.name}`;
  entries.unshift(...recordEntries(layers));
  const none =
    mesh || !hasMesh ? "" : "The shaft speed of this record is unknown, so mesh lines are not marked. ";
  return {
    traces: [line(layers[0], scale), marks(points, colour, scale)],
    others: others.map((layer) => line(layer, scale)),
    table: () => recordColumns(layers, columns),
    legend: entries,
    sub: `${none}${convention(spectrum)}.${note}`,
    summary: `Amplitude spectrum${points.length ? `: ${points.map((point) => point.words).join("; ")}` : ""}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      hoverdistance: 12,
      xaxis: {
        title: { text: axis.title },
        range,
        uirevision: axisRevision,
        exponentformat: "none",
      },
      yaxis: axisOfAmplitudes(layers, range, scale, axisRevision),
      shapes,
      annotations,
    },
  };
}

const NEAR_SHAFTS = 6; // shaft rates in the zoomed view, or more:
const NEAR_FAULTS = 1.5; // times the highest fault frequency of a bearing
const SLOW = 0.25; // of the shaft speed: a line below it, as at 0 Hz, is none of the machine's
const ENVELOPE_MESH_LINES = 3;

/** Whether an envelope is shown near its lines: as the address says, by default if there are bearings. */
export const isNear = ({ near }, bearings) => (near ? near === "1" : Object.keys(bearings).length > 0);

/** The end of the view near the lines of shafts and bearings. */
function nearEnd(shaft, bearings) {
  const faults = Object.values(bearings).flatMap((orders) => BEARING_LINES.map(([key]) => orders[key]));
  return shaft * Math.max(NEAR_SHAFTS, NEAR_FAULTS * Math.max(0, ...faults));
}

/**
 * The displayed range `[from, to]` of an envelope spectrum, null for all of it; and the range of its marked
 * lines.
 */
export function envelopeParts(spectrum, near, bearings) {
  const { shaft_speed_hz: shaft, mesh_frequency_hz: mesh, resolution_hz: step } = spectrum;
  const end = shaft ? nearEnd(shaft, bearings) : 0;
  const marked = Math.max(end, ENVELOPE_MESH_LINES * (mesh ?? 0));
  return {
    part: near && end ? [0, end] : null,
    read: marked ? [0, marked + 2 * step] : null,
  };
}

const BAND_SOURCES = {
  query: "as requested",
  asset: "set for the asset",
  strongest_mesh_harmonic: "around the strongest mesh harmonic",
  kurtogram: "found by the kurtogram",
  impacts: "resonance excited by bearing impacts",
  whole: "the whole band",
};

/** The lines of shafts, mesh and bearings in an envelope spectrum. */
function knownLines(shaft, teeth, bearings) {
  const lines = [];
  const driven = teeth ? (shaft * teeth[0]) / teeth[1] : shaft;
  if (Math.abs(driven / shaft - 1) > 0.02)
    lines.push({ frequency_hz: driven, label: "driven", name: "driven shaft", kind: "shafts" });
  for (let k = 1; k <= 5; k++)
    lines.push({
      frequency_hz: k * shaft,
      label: k === 1 ? "shaft 1×" : `${k}×`,
      name: `${teeth ? "driving shaft" : "shaft"} ${k}×`,
      kind: "shafts",
    });
  for (let k = 1; teeth && k <= ENVELOPE_MESH_LINES; k++)
    lines.push({
      frequency_hz: k * shaft * teeth[0],
      label: `mesh ${k}×`,
      name: `mesh ${k}×`,
      kind: "mesh",
    });
  for (const [bearing, orders] of Object.entries(bearings))
    for (const [key, name] of BEARING_LINES)
      lines.push({
        frequency_hz: orders[key] * shaft,
        label: name,
        name: `${name} of bearing ${bearing}`,
        kind: "bearings",
      });
  return lines;
}

const LABEL = 0.055; // width of a label as a fraction of the plot
const NARROW_LABEL = 0.13;

/** One label for each group of lines that are closer than a label is wide, at the group's first line. */
function sharedLabels(points, [from, to]) {
  const width = isNarrow() ? NARROW_LABEL : LABEL;
  const groups = [];
  for (const point of [...points].sort((a, b) => a.frequency_hz - b.frequency_hz)) {
    const last = groups.at(-1)?.at(-1);
    if (last && point.frequency_hz - last.frequency_hz < width * (to - from)) groups.at(-1).push(point);
    else groups.push([point]);
  }
  return groups.map((group) => {
    const names =
      group.length > 2 ? new Set(group.map(({ kind }) => kind)) : group.map(({ label: own }) => own);
    return {
      ...group[0],
      amplitude: Math.max(...group.map(({ amplitude }) => amplitude)),
      label: [...names].join(", "),
      anchor: group.length > 1 ? { xanchor: "left", xshift: -5 } : {},
    };
  });
}

/**
 * Draws the envelope spectra of records, `near` the lines of shafts and bearings or whole; `teeth` are those
 * of the driving and driven gear, if any, `bearings` fault orders by name, both of the first record's machine; a cursor may
 * have marked the bearings' lines.
 * @param {import("./layers.js").Layer[]} layers
 */
export function envelopeDrawing(
  layers,
  { teeth, bearings },
  { scale, near, part, isMarked = false, note = "" },
  revision,
) {
  const colour = palette();
  const [{ data: envelope }, ...others] = layers;
  const axis = axisOf(envelope);
  const {
    shaft_speed_hz: shaft,
    band_hz: [low, high],
    band_source: source,
  } = envelope;
  const whole = Math.min(envelope.frequency_hz.at(-1), (high - low) / (envelope.hertz_per_unit ?? 1));
  const end = near && shaft && !part ? Math.min(whole, nearEnd(shaft, bearings)) : whole;
  const range = part ?? [0, end];
  if (scale === "change") return changeDrawing(layers, axis, range, note, revision);
  const lines = shaft ? knownLines(shaft, teeth, isMarked ? {} : bearings) : [];
  const points = lines
    .filter((point) => point.frequency_hz <= end)
    .map((point) => {
      const amplitude = amplitudeAt(envelope, point.frequency_hz) ?? 0;
      return {
        ...point,
        amplitude,
        words: `${point.name}: ${axis.format(point.frequency_hz)}, ${number(amplitude)} ${unit(envelope.unit)}`,
      };
    });
  const kinds = [...new Set(points.map(({ kind }) => kind))];
  const judged = [Math.max(range[0], SLOW * (shaft ?? 0)), range[1]];
  return {
    title: `Envelope spectrum, ${number(low, 4)} to ${number(high, 4)} Hz`,
    traces: [line(layers[0], scale), marks(points, colour, scale)],
    others: others.map((layer) => line(layer, scale)),
    table: () => recordColumns(layers, columns),
    legend: [
      ...recordEntries(layers),
      ...(points.length
        ? [["diamond", colour.reference, `lines of ${kinds.join(", ")}; shaft ${axis.format(shaft)}`]]
        : []),
    ],
    sub: `Band ${BAND_SOURCES[source] ?? source}. ${convention(envelope)}.${note}`,
    summary: `Envelope spectrum of the band ${number(low)} to ${number(high)} Hz: ${points.map((point) => point.words).join("; ") || "shaft speed unknown"}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      hoverdistance: 12,
      xaxis: {
        title: { text: axis === HERTZ ? "Modulation frequency (Hz)" : axis.title },
        range,
        uirevision: `${revision} ${range}`,
      },
      yaxis: axisOfAmplitudes(layers, judged, scale, `${revision} ${range}`),
      shapes: points.map((point) => verticalLine(point.frequency_hz, colour.reference, "dot")),
      annotations: sharedLabels(
        points.filter(({ frequency_hz: x }) => x >= range[0] && x <= range[1]),
        range,
      ).map((point) => ({ ...label(point, colour, scale), ...point.anchor })),
    },
  };
}
