// Wear over time: median with 50 and 90 % bands, limits, the baseline, and the reference if any.

import { detailWords } from "./fine-history.js";
import { forecastOf } from "./forecast.js";
import { depth } from "./format.js";
import { hindsightLines } from "./hindsight.js";
import { inspectionMarks } from "./inspection.js";
import { eventMarks, eventsOn, wordsAt } from "./life-events.js";
import { horizontalLine, palette, recordPoints, timeAxis, timeMargin, verticalLine } from "./plots.js";

/** The outline of a band: one closed polygon per run of records that have both edges. */
function bandOutline(items, low, high) {
  const x = [];
  const y = [];
  let stretch = [];
  const close = () => {
    if (stretch.length > 1) {
      const back = [...stretch].reverse();
      x.push(...stretch.map((item) => item.start_time), ...back.map((item) => item.start_time), null);
      y.push(...stretch.map((item) => item[high]), ...back.map((item) => item[low]), null);
    }
    stretch = [];
  };
  for (const item of items) {
    if (item[low] == null || item[high] == null) close();
    else stretch.push(item);
  }
  close();
  return { x, y };
}

/** A level with its label: at the start of the line for a limit, at its end for the level of an alarm. */
function limitLine(name, value, colour, dash, ends, isLimit) {
  const trace = {
    x: ends,
    y: [value, value],
    mode: "lines",
    line: { color: colour, width: 1, dash },
    opacity: 0,
    hoverinfo: "skip",
  };
  const shape = horizontalLine(value, { color: colour, width: 1.5, dash });
  const text = `${name} ${depth(value)} µm`;
  const annotation = {
    text,
    xref: "paper",
    ...(isLimit ? { x: 0, xanchor: "left", xshift: 22 } : { x: 1, xanchor: "right", xshift: -4 }),
    y: value,
    yanchor: isLimit ? "bottom" : "top",
    showarrow: false,
    font: { color: colour },
  };
  return { trace, shape, annotation };
}

function hoverWords(
  {
    start_time: time,
    median_um: median,
    low_um: low,
    p25_um: quarter,
    p75_um: threeQuarters,
    high_um: high,
    reference_wear_um: reference,
    status,
    reason,
  },
  events,
) {
  const lines = [
    median == null
      ? (reason ?? status)
      : `median ${depth(median)} µm, 90 %: ${depth(low)} to ${depth(high)} µm`,
  ];
  if (quarter != null) lines.push(`25 to 75 %: ${depth(quarter)} to ${depth(threeQuarters)} µm`);
  if (median != null && status !== "estimated") lines.push(status.replaceAll("_", " "));
  if (reference != null) lines.push(`reference ${depth(reference)} µm`);
  return [...lines, ...(events.get(time) ?? [])].join("<br>");
}

/** Why there is no estimate at all; null when there is one or the baseline is being collected. */
export function withoutEstimate(items) {
  const none = items.every((item) => item.median_um == null && item.status !== "collecting_baseline");
  return none
    ? `Wear is not estimated: ${items.at(-1).reason ?? items.at(-1).status.replaceAll("_", " ")}.`
    : null;
}

/** The events without inspections, which are points of this plot instead of lines over it. */
function withoutInspections(events) {
  const { maintenance } = events;
  return maintenance instanceof Error
    ? events
    : { ...events, maintenance: { items: maintenance.items.filter(({ inspection }) => !inspection) } };
}

/** Runs of consecutive baseline records; maintenance starts a new one. */
function baselineStretches(items) {
  const stretches = [];
  items.forEach((item, index) => {
    if (item.status !== "collecting_baseline") return;
    if (items[index - 1]?.status === "collecting_baseline") stretches.at(-1).push(item);
    else stretches.push([item]);
  });
  return stretches.filter((stretch) => stretch.length > 1);
}

/** Labelled shading of the baselines. */
function baselineZones(items, colour) {
  const common = { yref: "paper", y: 0.5, showarrow: false, font: { color: colour.muted } };
  return baselineStretches(items).map((stretch) => {
    const [from, to] = [stretch[0].start_time, stretch.at(-1).start_time];
    const shape = {
      type: "rect",
      xref: "x",
      yref: "paper",
      x0: from,
      x1: to,
      y0: 0,
      y1: 1,
      layer: "below",
      line: { width: 0 },
      fillcolor: colour.zone,
    };
    const only = stretch.length === items.length;
    const annotation = only
      ? {
          ...common,
          y: 0.3,
          bgcolor: colour.surface,
          text: `${items.at(-1).reason ?? "collecting baseline"}:<br>no wear estimate yet`,
          xref: "paper",
          x: 0.5,
        }
      : {
          ...common,
          text: "baseline",
          x: new Date((Date.parse(from) + Date.parse(to)) / 2).toISOString(),
          y: 0.2,
          textangle: -90,
        };
    return { shape, annotation };
  });
}

const STRIP = 0.06; // height of the strip below the plot for records without an estimate, as a fraction of the plot
const ROOM = 0.02; // beside the first and the last record, as a fraction of the range
const LONE_ROOM_MS = 300_000; // to each side of a single record

/**
 * The range from the first to the last record. Set explicitly: Plotly loses all points when a forecast and
 * its range disappear.
 */
function rangeOf(items) {
  const [first, last] = [Date.parse(items[0].start_time), Date.parse(items.at(-1).start_time)];
  const room = last > first ? Math.max(ROOM * (last - first), 500) : LONE_ROOM_MS;
  return [first - room, last + room].map((time) => new Date(time).toISOString());
}

/** The time range of the plots over an asset's life, including the forecast; undefined without records. */
export function timeRange(history, latest) {
  if (history instanceof Error || history.items.length === 0) return undefined;
  return forecastOf(history.items, latest, palette())?.range ?? rangeOf(history.items);
}

/** Parses `time` of an address into a range, or null. */
export function timeOf(text) {
  const ends = (text ?? "").split("~").map((end) => new Date(end));
  return ends.length === 2 && ends[1] > ends[0] ? ends.map((end) => end.toISOString()) : null;
}

/** Formats a range for an address. */
export function formatTime(range) {
  return range && range.map((end) => `${new Date(end).toISOString().slice(0, 19)}Z`).join("~");
}

/**
 * Draws a wear history; `selected` is the start time of the displayed record, `zoomed` a time range or null,
 * `rule` the alarm rule on the depth.
 */
export function wearDrawing(history, limits, selected, revision, latest, allEvents, zoomed, rule) {
  const { channel, items } = history;
  const events = eventsOn(allEvents, ["wear_um"]);
  const colour = palette();
  const ends = [items[0].start_time, items.at(-1).start_time];
  const times = items.map((item) => item.start_time);
  const markers = items.length < 40 ? "lines+markers" : "lines";
  const caused = wordsAt(events);
  const estimated = items.some((item) => item.median_um != null);
  const halved = items.some((item) => item.p25_um != null);
  const entries = estimated
    ? [
        ["line", colour.accent, "median"],
        ...(halved ? [["band", colour.halfOnBand, "25 to 75 %"]] : []),
        ["band", colour.band, "90 % interval"],
      ]
    : [];
  /** @type {any[]} */
  const traces = [
    {
      ...bandOutline(items, "low_um", "high_um"),
      mode: "lines",
      fill: "toself",
      fillcolor: colour.band,
      line: { width: 0 },
      hoverinfo: "skip",
    },
    {
      ...bandOutline(items, "p25_um", "p75_um"),
      mode: "lines",
      fill: "toself",
      fillcolor: colour.half,
      line: { width: 0 },
      hoverinfo: "skip",
    },
    {
      x: times,
      y: items.map((item) => item.median_um),
      mode: markers,
      line: { color: colour.accent, width: 2 },
      hoverinfo: "skip",
    },
    recordPoints(
      items,
      items.map((item) => item.median_um ?? 0),
      (item) => hoverWords(item, caused),
    ),
  ];
  const unknown = items.filter((item) => item.median_um == null);
  if (unknown.length) {
    // Ticks below the depths: a record without an estimate does not mean zero wear
    traces.push({
      x: unknown.map((item) => item.start_time),
      y: unknown.map(() => 0.5),
      yaxis: "y2",
      mode: "markers",
      marker: {
        symbol: "line-ns-open",
        size: 8,
        color: colour.muted,
        line: { width: 1.5, color: colour.muted },
      },
      hoverinfo: "skip",
    });
    entries.push(["ticks", colour.muted, "records without an estimate"]);
  }
  if (items.some((item) => item.reference_wear_um != null)) {
    const line = { color: colour.reference, width: 2, dash: "dot" };
    traces.push({
      x: times,
      y: items.map((item) => item.reference_wear_um),
      mode: markers,
      line,
      hoverinfo: "skip",
    });
    entries.push(["dot", colour.reference, "reference (simulated or inspected)"]);
  }
  const zones = baselineZones(items, colour);
  /** @type {any[]} */
  const shapes = zones.map(({ shape }) => shape);
  /** @type {any[]} */
  const annotations = zones.map(({ annotation }) => annotation);
  for (const [name, value, dash] of [
    ["warning", limits?.warning_um, "dash"],
    ["danger", limits?.danger_um, "solid"],
  ]) {
    const levels = [
      [name, value],
      [`${name} alarm above`, rule?.[name] === value ? null : rule?.[name]],
      [`${name} alarm below`, rule?.[`${name}_below`]],
    ];
    for (const [words, level] of levels) {
      if (level == null) continue;
      const line = limitLine(words, level, colour[name], dash, ends, words === name);
      traces.push(line.trace);
      shapes.push(line.shape);
      annotations.push(line.annotation);
    }
  }
  const forecast = forecastOf(items, latest, colour);
  if (forecast) {
    traces.push(...forecast.traces);
    entries.push(["dash", colour.series[1], forecast.words]);
  }
  const whole = forecast?.range ?? rangeOf(items);
  const inspected = inspectionMarks(events, colour, whole);
  traces.push(...inspected.traces);
  annotations.push(...inspected.annotations);
  entries.push(...inspected.entries);
  const lookedBack = hindsightLines(events.hindsight, colour);
  traces.push(...lookedBack.traces);
  entries.push(...lookedBack.entries);
  const happened = eventMarks(withoutInspections(events), colour, items);
  shapes.push(...happened.shapes);
  annotations.push(...happened.annotations);
  entries.push(...happened.entries);
  if (selected) shapes.push(verticalLine(selected, colour.select, "solid", 2));
  const range = zoomed ?? whole;
  const last = items.findLast((item) => item.median_um != null);
  const now = last
    ? `the last median is ${depth(last.median_um)} µm, interval ${depth(last.low_um)} to ${depth(last.high_um)} µm`
    : "no estimate yet";
  return {
    traces,
    legend: entries,
    table: () =>
      [
        "start_time",
        "segment_id",
        "status",
        "median_um",
        "low_um",
        "p25_um",
        "p75_um",
        "high_um",
        "reference_wear_um",
      ].map((key) => [key, items.map((item) => item[key])]),
    sub: `Greatest wear depth over the flank, channel ${channel}. Click a record to see it.${detailWords(history)}`,
    summary: `Wear depth over ${items.length} records: ${now}.`,
    layout: {
      uirevision: revision,
      hovermode: "x unified",
      hoverdistance: -1,
      xaxis: { ...timeAxis(), range, ...(unknown.length && { anchor: "y2" }) },
      margin: { ...timeMargin, t: timeMargin.t + happened.top },
      yaxis: {
        title: { text: "Wear depth (µm)" },
        rangemode: "tozero",
        automargin: false,
        domain: [unknown.length ? STRIP : 0, 1],
      },
      ...(unknown.length && {
        yaxis2: { domain: [0, STRIP], range: [0, 1], fixedrange: true, visible: false },
      }),
      shapes,
      annotations,
    },
  };
}
