// Indicator trends: one pane per kind of indicator over a common time axis.

import { detailWords } from "./fine-history.js";
import { binEntries, binTraces } from "./operating-bins.js";
import { indicatorName, number, titled, unit } from "./format.js";
import { eventMarks, eventsOn, wordsAt } from "./life-events.js";
import { velocityZones } from "./velocity-zones.js";
import { palette, recordPoints, timeAxis, timeMargin, verticalLine } from "./plots.js";

/** The standard panes; `mesh` holds every mesh harmonic in the records, `ofMesh` ones need a gear mesh. */
export const PANES = [
  { key: "rms", label: "RMS", names: ["rms"] },
  { key: "velocity_rms", label: "Velocity", names: ["velocity_rms"] },
  { key: "kurtosis", label: "Kurtosis", names: ["kurtosis"] },
  { key: "omx", label: "OMX", names: ["omx"], ofMesh: true },
  { key: "crest_factor", label: "Crest factor", names: ["crest_factor"] },
  { key: "fm4", label: "FM4", names: ["fm4"], ofMesh: true },
  { key: "na4", label: "NA4", names: ["na4"], ofMesh: true },
  { key: "novelty", label: "Novelty", names: ["novelty"] },
  { key: "mesh", label: "Mesh harmonics", names: [], ofMesh: true },
];
const DEFAULT = "rms,kurtosis,omx";
const DEFAULT_WITHOUT_MESH = "rms,velocity_rms,kurtosis";
const GAP = 0.05;
const LEVEL_REACH = 4; // an alarm level up to this many times the largest value is brought into view

/** The panes of an address, at least one; a non-standard name is an indicator. */
export function chosenPanes(text, hasMesh = true) {
  const wanted = text ?? (hasMesh ? DEFAULT : DEFAULT_WITHOUT_MESH);
  const keys = wanted.split(",").filter((key) => /^[a-z][a-z0-9_]*$/.test(key));
  const usual = PANES.filter((pane) => keys.includes(pane.key) && (hasMesh || !pane.ofMesh));
  const others = keys
    .filter((key) => !PANES.some((pane) => pane.key === key))
    .map((key) => ({ key, label: indicatorName(key), names: [key] }));
  const chosen = [...usual, ...others];
  return chosen.length ? chosen : PANES.slice(0, 1);
}

/** A record's indicators without a standard pane. */
export function otherNames(record) {
  const shown = new Set(PANES.flatMap((pane) => pane.names));
  const { indicators = {}, absent = {} } = record ?? {};
  return [...Object.keys(indicators), ...Object.keys(absent)]
    .filter((name) => !shown.has(name) && !/^mesh_\d+$/.test(name))
    .sort();
}

/** The indicators to fetch. The record's own indicators give the number of mesh harmonics. */
export function paneNames(panes, record) {
  const { indicators: values = {}, absent = {} } = record ?? {};
  const mesh = [...Object.keys(values), ...Object.keys(absent)]
    .filter((name) => /^mesh_\d+$/.test(name))
    .sort((a, b) => Number(a.slice(5)) - Number(b.slice(5)));
  return panes.flatMap((pane) => (pane.key === "mesh" ? mesh : pane.names));
}

const MEANINGS = {
  omx: "OMX is the peak amplitude of the first mesh line.",
  kurtosis: "Kurtosis is 3 for Gaussian noise.",
  fm4: "FM4 is the kurtosis of the difference signal.",
  na4: "NA4 is the fourth moment of the residual over its running mean.",
  novelty: "Novelty measures deviations that wear does not explain.",
};

/** What the displayed indicators mean, where the name does not say it. */
const meanings = (panes) =>
  panes
    .filter(({ key }) => MEANINGS[key])
    .map(({ key }) => ` ${MEANINGS[key]}`)
    .join("");

const FLAT = 1e-3; // of the greatest value: ticks of a narrower range have more digits than fit beside the axis

/**
 * The range of an axis for values that are almost the same; undefined for others.
 * @param {number[]} values
 */
function flatRange(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
  const least = FLAT * Math.max(Math.abs(low), Math.abs(high));
  return high >= low && high - low < least ? [(low + high - least) / 2, (low + high + least) / 2] : undefined;
}

const MAX_TICKS = 7;

/**
 * Ticks of a logarithmic axis as full numbers: between decades Plotly writes single digits, so 0.5 and 50
 * both read 5. Narrow ranges keep Plotly's ticks, which are full numbers.
 */
function logarithmicTicks(values) {
  const positive = values.filter((value) => value > 0);
  const [low, high] = [Math.min(...positive), Math.max(...positive)];
  const decades = Array.from({ length: 40 }, (_, n) => n - 20).map((power) => Number(`1e${power}`));
  const within = (steps) =>
    decades
      .flatMap((decade) => steps.map((step) => step * decade))
      .filter((value) => value > 0.8 * low && value < 1.25 * high);
  const ticks = [[1, 2, 5], [1]].map(within).find(({ length }) => length <= MAX_TICKS) ?? [];
  if (ticks.length < 2) return { tickmode: "auto" };
  return { tickmode: "array", tickvals: ticks, ticktext: ticks.map((value) => number(value, 3)) };
}

/** The indicators of a pane. */
function namesOf(pane, names) {
  return pane.key === "mesh" ? names.filter((name) => name.startsWith("mesh_")) : pane.names;
}

function axisTitle(pane, units) {
  if (pane.key === "mesh") return titled("Mesh lines", units.mesh_1);
  if (pane.key === "omx") return titled("OMX", units.omx);
  if (pane.key === "novelty") return "Novelty (−log₁₀ p)";
  return titled(pane.label, units[pane.names[0]]);
}

/** Alarm levels of an indicator as labelled lines over its pane. */
function levelLines(name, rules, unitName, suffix, colour, logarithmic) {
  const rule = rules.find(({ quantity }) => quantity === name || quantity?.indicator === name);
  const all = ["warning", "danger"].flatMap((severity) => [
    { severity, side: "above", level: rule?.[severity] },
    { severity, side: "below", level: rule?.[`${severity}_below`] },
  ]);
  const levels = all.filter(({ level }) => level != null && !(logarithmic && level <= 0));
  const place = { xref: "paper", yref: `y${suffix}` };
  return {
    shapes: levels.map(({ severity, level }) => ({
      ...place,
      type: "line",
      layer: "below",
      x0: 0,
      x1: 1,
      y0: level,
      y1: level,
      line: { color: colour[severity], width: 1.5, dash: severity === "danger" ? "solid" : "dash" },
    })),
    annotations: levels.map(({ severity, side, level }) => ({
      ...place,
      // The labels of two levels may be at the same height
      ...(severity === "warning" ? { x: 0.005, xanchor: "left" } : { x: 0.995, xanchor: "right" }),
      yanchor: side === "above" ? "bottom" : "top",
      y: logarithmic ? Math.log10(level) : level,
      text: `${severity} ${side} ${number(level)} ${unit(unitName)}`.trim(),
      showarrow: false,
      font: { color: colour[severity] },
    })),
  };
}

/**
 * Draws indicators over time. `rules` are the alarm rules in force, `range` the range of the wear plot above
 * when it contains a forecast, `limits` the velocity zone limits.
 */
export function trendDrawing(
  indicators,
  panes,
  names,
  logarithmic,
  selected,
  { revision, bins = null, events, range, rules = [], limits = null },
) {
  const { items, units, channel } = indicators;
  const shownEvents = eventsOn(events, names);
  const colour = palette();
  const times = items.map((item) => item.start_time);
  const mode = items.length < 40 ? "lines+markers" : "lines";
  const height = (1 - GAP * (panes.length - 1)) / panes.length;
  /** @type {any} */
  const layout = {
    uirevision: revision,
    hovermode: "x unified",
    hoversubplots: "axis",
    hoverdistance: -1,
    margin: timeMargin,
    xaxis: { ...timeAxis(), anchor: panes.length > 1 ? `y${panes.length}` : "y" },
    shapes: selected ? [verticalLine(selected, colour.select, "solid", 2)] : [],
  };
  const caused = wordsAt(shownEvents);
  const traces = [];
  const entries = [];
  const annotations = [];
  panes.forEach((pane, index) => {
    const suffix = index ? String(index + 1) : "";
    const top = 1 - index * (height + GAP);
    layout[`yaxis${suffix}`] = {
      domain: [Math.max(0, top - height), top],
      type: logarithmic ? "log" : "linear",
      ...(logarithmic
        ? logarithmicTicks(items.flatMap((item) => namesOf(pane, names).map((name) => item[name])))
        : { tickmode: "auto" }),
      title: { text: axisTitle(pane, units) },
      nticks: panes.length > 3 ? 3 : 5,
      automargin: false,
      // Another scale or set of panes starts from its own range
      uirevision: `${revision} ${logarithmic} ${panes.map(({ key }) => key)}`,
    };
    const shown = namesOf(pane, names);
    const words = (item) =>
      shown
        .map((name) => `${indicatorName(name)} ${number(item[name])} ${unit(units[name])}`.trim())
        .concat(shown[0] === "velocity_rms" && item.velocity_zone ? `zone ${item.velocity_zone}` : [])
        .concat(index === 0 ? (caused.get(item.start_time) ?? []) : [])
        .join("<br>");
    const points = recordPoints(
      items,
      items.map((item) => item[shown[0]]),
      words,
    );
    traces.push({ ...points, xaxis: "x", yaxis: `y${suffix}` });
    const drawn = shown.flatMap((name) => items.map((item) => item[name])).filter(Number.isFinite);
    if (shown.length === 1) {
      const levels = levelLines(shown[0], rules, units[shown[0]], suffix, colour, logarithmic);
      layout.shapes.push(...levels.shapes);
      annotations.push(...levels.annotations);
      // Shapes do not widen an axis, traces do; a level far above all values would flatten them
      const greatest = Math.max(...items.map((item) => item[shown[0]] ?? 0));
      const near = levels.shapes
        .map(({ y0 }) => y0)
        .filter((level) => shown[0] === "novelty" || level < LEVEL_REACH * greatest);
      if (limits && shown[0] === "velocity_rms") {
        const values = items.map((item) => item.velocity_rms);
        const zones = velocityZones(limits, suffix, { colour, logarithmic, values, levels: near });
        layout.shapes.unshift(...zones.shapes);
        layout[`yaxis${suffix}`].range = zones.range;
        annotations.push(...zones.annotations);
        entries.push(...zones.entries);
      }
      drawn.push(...near);
      if (near.length)
        traces.push({
          x: near.map(() => times[0]),
          y: near,
          xaxis: "x",
          yaxis: `y${suffix}`,
          mode: "markers",
          opacity: 0,
          hoverinfo: "skip",
        });
    }
    if (!logarithmic) layout[`yaxis${suffix}`].range ??= flatRange(drawn);
    if (bins && shown.length === 1) {
      traces.push(
        ...binTraces(items, shown[0], bins, colour).map((trace) => ({
          ...trace,
          xaxis: "x",
          yaxis: `y${suffix}`,
        })),
      );
      return;
    }
    shown.forEach((name, order) => {
      const line = {
        color: shown.length > 1 ? colour.series[order % colour.series.length] : colour.accent,
        width: 1.5,
        dash: order < 5 ? "solid" : "dot",
      };
      const y = items.map((item) => item[name]);
      traces.push({ x: times, y, yaxis: `y${suffix}`, xaxis: "x", mode, line, hoverinfo: "skip" });
      if (shown.length > 1) entries.push([order < 5 ? "line" : "dot", line.color, indicatorName(name)]);
    });
  });
  // Points at the ends would widen the axis, which must match the wear plot above
  if (range ?? bins) layout.xaxis.range = range ?? [times[0], times.at(-1)];
  const happened = eventMarks(shownEvents, colour, items);
  layout.shapes.push(...happened.shapes);
  layout.annotations = [...annotations, ...happened.annotations];
  layout.margin = { ...timeMargin, t: timeMargin.t + happened.top };
  entries.push(...happened.entries);
  if (bins) entries.push(...binEntries(bins, colour));
  return {
    traces,
    layout,
    legend: entries,
    table: () =>
      ["start_time", "segment_id", ...names].map((key) => [
        units[key] ? `${key} (${units[key]})` : key,
        items.map((item) => item[key]),
      ]),
    sub: `Channel ${channel}.${meanings(panes)}${bins?.words ? ` ${bins.words}` : ""}${detailWords(indicators)}`,
    summary: `Trends of ${panes.map((pane) => pane.label).join(", ")} over ${items.length} records.`,
  };
}
