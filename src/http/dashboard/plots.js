// Plotly with the page's fonts and colours. It is large, so it is loaded with the first plot that needs it.
// Plots that rest are static until the user interacts with one.

import { h, svg } from "./dom.js";
import { recordEarlyEvents } from "./early-pointer.js";
import { staticPlot } from "./static-plot.js";
import { colours, translucent } from "./theme.js";
import { fromAxis, isLocal, onAxis, zoneName } from "./time-zone.js";

let loading;

function load() {
  loading ??= new Promise((resolve, reject) => {
    const script = h("script", { src: new URL("static/plotly.js", document.baseURI).href });
    script.addEventListener("load", () => {
      resolve(globalThis.Plotly);
      activateAll();
    });
    script.addEventListener("error", () => {
      loading = undefined;
      script.remove();
      reject(new Error("failed to load the plotting library"));
    });
    document.head.append(script);
  });
  return loading;
}

/** The plot colours of the current theme. */
export function palette() {
  const values = colours(
    "ink",
    "muted",
    "line",
    "surface",
    "accent",
    "normal",
    "learning",
    "warning",
    "danger",
    "reference",
    "select",
    "edge",
    "series-1",
    "series-2",
    "series-3",
    "series-4",
    "series-5",
    "series-6",
    "series-7",
    "series-8",
  );
  const series = [1, 2, 3, 4, 5].map((index) => values[`series-${index}`]);
  const records = [1, 2, 3, 4, 6, 7, 8, 5].map((index) => values[`series-${index}`]);
  return {
    ...values,
    series,
    records,
    other: values["series-2"],
    band: translucent(values.accent, 0.2),
    half: translucent(values.accent, 0.28),
    halfOnBand: translucent(values.accent, 0.42),
    zone: translucent(values.muted, 0.12),
  };
}

const axis = (colour) => ({
  automargin: true,
  gridcolor: translucent(colour.line, 0.7),
  linecolor: colour.line,
  zerolinecolor: colour.line,
  ticks: "outside",
  tickcolor: colour.line,
  title: { standoff: 8 },
});

/** A time axis. Plotly shows times as written, so `draw` converts them to the selected time zone. */
export const timeAxis = () => ({
  type: "date",
  tickangle: 0,
  nticks: matchMedia("(max-width: 40rem)").matches ? 4 : 6,
  title: { text: `Start of record (${zoneName()})`, standoff: 8 },
  hoverformat: isLocal() ? "%Y-%m-%d %H:%M:%S" : "%Y-%m-%d %H:%M:%S UTC",
});

/** Converts a drawing's times to the browser's time zone if selected. */
function byClock(traces, layout) {
  const names = Object.keys(layout).filter((key) => layout[key]?.type === "date");
  if (!isLocal() || names.length === 0) return { traces, layout };
  const axes = names.map((key) => key.replace("axis", ""));
  const isTime = (name = "x") => axes.includes(name);
  const write = (time) => (time === null || time === undefined ? time : onAxis(time));
  const shape = (each) => {
    if (!isTime(each.xref)) return each;
    // A size in pixels is anchored at a time
    if (each.xsizemode === "pixel") return { ...each, xanchor: write(each.xanchor) };
    return { ...each, x0: write(each.x0), x1: write(each.x1) };
  };
  return {
    traces: traces.map((trace) =>
      isTime(trace.xaxis) && trace.x ? { ...trace, x: trace.x.map(write) } : trace,
    ),
    layout: {
      ...layout,
      ...(layout.shapes && { shapes: layout.shapes.map(shape) }),
      ...(layout.annotations && {
        annotations: layout.annotations.map((each) =>
          isTime(each.xref) ? { ...each, x: write(each.x) } : each,
        ),
      }),
      ...Object.fromEntries(
        names
          .filter((key) => layout[key].range)
          .map((key) => [key, { ...layout[key], range: layout[key].range.map(write) }]),
      ),
    },
  };
}

/** Margins of time plots; fixed, so that stacked plots are aligned in time. Seven digits fit on the left. */
export const timeMargin = { l: 78, r: 14, t: 10, b: 8 };

/**
 * One invisible point per record for hovering and clicking instead of the lines: lines have gaps, for which
 * Plotly would report the nearest record with a value. `values` are the heights of the points; missing ones
 * get any other value.
 */
export function recordPoints(items, values, words) {
  const fallback = values.find((value) => value != null) ?? 1;
  return {
    x: items.map((item) => item.start_time),
    y: values.map((value) => value ?? fallback),
    customdata: items.map((item) => item.segment_id),
    text: items.map(words),
    mode: "lines",
    line: { width: 0 },
    opacity: 0,
    hovertemplate: "%{text}<extra></extra>",
  };
}

/** Merges a plot's layout into the common one; keys starting with `xaxis` or `yaxis` are axes. */
function themed(layout, colour) {
  const small = matchMedia("(max-width: 40rem)").matches;
  const axes = Object.entries(layout).filter(([key]) => /^[xy]axis/.test(key));
  const base = axis(colour);
  return {
    margin: { l: 8, r: small ? 8 : 14, t: 10, b: 8 },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { family: getComputedStyle(document.body).fontFamily, size: small ? 11 : 12, color: colour.ink },
    hoverlabel: {
      bgcolor: colour.surface,
      bordercolor: colour.line,
      font: { color: colour.ink },
      align: "left",
    },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour.muted, activecolor: colour.accent },
    showlegend: false,
    separators: ".\u202f", // thousands are set apart from 10 000, as in the texts
    // a drag on a touch screen scrolls the page
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    ...layout,
    ...Object.fromEntries(
      axes.map(([key, own]) => [key, { ...base, ...own, title: { ...base.title, ...own.title } }]),
    ),
  };
}

// A picture has its title and legend beside it; the card exports it
const BUTTONS_LEFT_OUT = ["lasso2d", "select2d", "autoScale2d", "toImage"];

const staticPlots = new Map(); // plots drawn without Plotly → their `[traces, layout]`
const arrivals = new WeakMap(); // plot → what to do when Plotly has drawn it

const pictureIn = (element) => element.querySelector(":scope > .static");

/** Draws a plot without Plotly; returns whether that was possible. */
function drawStatic(element, traces, layout) {
  const { clientWidth: width, clientHeight: height } = element;
  const shown = byClock(traces, layout);
  const picture = staticPlot(shown.traces, themed(shown.layout, palette()), { width, height });
  if (!picture) return false;
  pictureIn(element)?.remove();
  element.append(picture);
  awaitPointer(element);
  staticPlots.set(element, [traces, layout]);
  return true;
}

/** Activates a static plot when the pointer comes to it. */
function awaitPointer(element) {
  if (element.dataset.awaited) return;
  element.dataset.awaited = "true";
  let repeat;
  const visit = () => {
    repeat ??= recordEarlyEvents(element);
    activate(element);
  };
  const visits = ["pointerenter", "pointerdown"];
  for (const name of visits) element.addEventListener(name, visit);
  whenActive(element, () => {
    for (const name of visits) element.removeEventListener(name, visit);
    if (repeat) queueMicrotask(repeat); // when everybody listens
  });
}

/** Lets Plotly take the place of a static drawing. */
async function replaceStatic(element) {
  if (!staticPlots.has(element)) return;
  await load();
  const shown = staticPlots.get(element);
  if (shown) await draw(element, ...shown);
}

/** Lets Plotly draw a static plot, if it is one. Without the library it stays as it is until the next try. */
export const activate = (element) => replaceStatic(element).catch(() => {});

/** Activates all static plots, one after the other: the one that needed Plotly comes first. */
async function activateAll() {
  for (const element of staticPlots.keys()) {
    await new Promise((done) => setTimeout(done));
    if (element.checkVisibility()) await activate(element);
  }
}

/** Does something with a plot now, or when Plotly has drawn it. */
export function whenActive(element, act) {
  if (element.on) act();
  else arrivals.set(element, [...(arrivals.get(element) ?? []), act]);
}

/**
 * Draws or redraws a plot. The user's zoom is kept while `layout.uirevision` stays the same. One that `rests`
 * does not load Plotly if it can be drawn without it.
 */
export async function draw(element, traces, layout, { rests = false } = {}) {
  clearTimeout(resting.get(element)); // a pending line update is outdated now
  if (rests && !globalThis.Plotly && drawStatic(element, traces, layout)) return;
  staticPlots.delete(element);
  const Plotly = await load();
  if (!element.isConnected) return;
  // On a touch screen the buttons would always cover the plot, and dragging is disabled
  const displayModeBar = matchMedia("(pointer: coarse)").matches ? false : "hover";
  const config = { displaylogo: false, displayModeBar, modeBarButtonsToRemove: BUTTONS_LEFT_OUT };
  const shown = byClock(traces, layout);
  await Plotly.react(element, shown.traces, themed(shown.layout, palette()), config);
  pictureIn(element)?.remove();
  const waiting = arrivals.get(element) ?? [];
  arrivals.delete(element);
  for (const act of waiting) act();
}

/** Draws the last line of a plot, a single path, through `[x, y]`; returns whether that was possible. */
function redrawLine(element, [x, y]) {
  const { xaxis, yaxis } = element._fullLayout;
  const paths = [...element.querySelectorAll(".scatterlayer .trace")].at(-1)?.querySelectorAll(".js-line");
  if (paths?.length !== 1 || !y.every(Number.isFinite)) return false;
  const points = x.map((value, n) => `${xaxis.d2p(value).toFixed(1)},${yaxis.d2p(y[n]).toFixed(1)}`);
  paths[0].setAttribute("d", `M${points.join("L")}`);
  return true;
}

/** Sets the bar heights and colours of a plot from `trace`; returns whether that was possible. */
function redrawBars(element, { y, marker }) {
  const bars = [...element.querySelectorAll(".barlayer .point > path")];
  const foot = /^(M[-\d.]+,[-\d.]+V)[-\d.]+(H[-\d.]+V[-\d.]+Z)$/;
  const parts = bars.map((bar) => foot.exec(bar.getAttribute("d") ?? ""));
  if (bars.length !== y.length || !parts.every(Boolean)) return false;
  const { yaxis } = element._fullLayout;
  bars.forEach((bar, n) => {
    const [, before, after] = parts[n];
    bar.setAttribute("d", `${before}${yaxis.d2p(y[n]).toFixed(1)}${after}`);
    bar.style.fill = marker.color[n];
  });
  return true;
}

const REST_MS = 250;
const resting = new WeakMap(); // plot → timer

/**
 * Shows the last trace of a plot, a line or bars, while a slider moves: only its paths are drawn, a tenth of
 * the work. Plotly is updated once the slider rests, for hover text. Returns whether that was possible.
 */
export function moveLast(element, trace) {
  clearTimeout(resting.get(element));
  const { x, y, customdata, marker } = trace;
  if (!element.data || !(trace.type === "bar" ? redrawBars(element, trace) : redrawLine(element, [x, y])))
    return false;
  const own = { x: [x], y: [y], ...(customdata && { customdata: [customdata] }) };
  const update = marker ? { ...own, "marker.color": [marker.color] } : own;
  const learn = () =>
    element.isConnected && globalThis.Plotly.restyle(element, update, [element.data.length - 1]);
  resting.set(element, setTimeout(learn, REST_MS));
  return true;
}

const WHOLE_MS = 1000;

/**
 * Gives the last line of a plot new values `[x, y]`. Several times a second only its path is drawn, a tenth
 * of the work; Plotly is updated once a second, for hover text.
 */
export async function replaceLine(element, [x, y]) {
  if (!element.data) return;
  const isWhole = performance.now() - Number(element.dataset.wholeAt ?? -WHOLE_MS) < WHOLE_MS;
  if (isWhole && redrawLine(element, [x, y])) return;
  element.dataset.wholeAt = String(performance.now());
  await globalThis.Plotly.restyle(element, { x: [x], y: [y] }, [element.data.length - 1]);
}

/** Calls back with the time or value of a clicked point, from Plotly's `customdata`. */
export function onPointClick(element, callback) {
  if (element.dataset.clickable) return;
  element.dataset.clickable = "true";
  whenActive(element, () =>
    element.on("plotly_click", (event) => {
      const point = event.points.find(({ customdata }) => customdata !== undefined);
      if (point) callback(Array.isArray(point.customdata) ? point.customdata[0] : point.customdata);
    }),
  );
}

/** The horizontal range that the user has given a plot; null for the whole one, undefined for no change. */
function rangeIn(event) {
  const { "xaxis.range": range, "xaxis.range[0]": from, "xaxis.range[1]": to } = event;
  if (range) return range;
  if (from !== undefined) return [from, to];
  return event["xaxis.autorange"] ? null : undefined;
}

/** Keeps the horizontal range of two plots equal. */
export function linkTimeAxes(...elements) {
  const follow = (other, range) => {
    const { autorange, range: current } = other.layout.xaxis;
    const isSame = range ? !autorange && String(current) === String(range) : autorange;
    const update = range ? { "xaxis.range": [...range] } : { "xaxis.autorange": true };
    if (!isSame) globalThis.Plotly.relayout(other, update);
  };
  for (const element of elements) {
    if (element.dataset.linked) continue;
    element.dataset.linked = "true";
    whenActive(element, () =>
      element.on("plotly_relayout", (event) => {
        const range = rangeIn(event);
        if (range === undefined) return;
        for (const other of elements.filter((each) => each !== element))
          whenActive(other, () => follow(other, range));
      }),
    );
  }
}

/** Fits a plot into its element whenever the element's size changes. */
export function keepFitted(element) {
  const observer = new ResizeObserver(() => {
    const { _fullLayout: layout, clientWidth: width, clientHeight: height } = element;
    const picture = pictureIn(element);
    const isFitting = picture?.clientWidth === width && picture.clientHeight === height;
    if (staticPlots.has(element) && width && height && !isFitting)
      drawStatic(element, ...staticPlots.get(element));
    if (layout && width && height && (layout.width !== width || layout.height !== height))
      globalThis.Plotly.Plots.resize(element);
  });
  observer.observe(element);
}

/** Exports a plot, drawn by `drawing`, as an image URL with `scale` pixels per page pixel. */
export async function pictureOf(element, scale, drawing) {
  const { traces, layout } = byClock(drawing.traces, drawing.layout);
  const own = themed(layout, palette()); // in the theme of this moment
  await replaceStatic(element);
  const shown = element._fullLayout; // with the ranges that the user sees
  const axes = Object.keys(own).filter((key) => /^[xy]axis/.test(key) && shown[key]?.range);
  const ranges = axes.map((key) => [key, { ...own[key], range: [...shown[key].range], autorange: false }]);
  return globalThis.Plotly.toImage(
    { data: traces, layout: { ...own, ...Object.fromEntries(ranges) } },
    { format: "png", scale, width: element.clientWidth, height: element.clientHeight },
  );
}

/** A position on a time axis as reported by Plotly: as written there, or in milliseconds. */
const instantOf = (end) =>
  typeof end === "string"
    ? fromAxis(end.replace(/Z$/, ""))
    : fromAxis(new Date(end).toISOString().slice(0, -1));

/**
 * Calls back with `[from, to]` when the user changes the horizontal range (ISO times on time axes), or null
 * for the whole range.
 */
export function onRangeChange(element, callback) {
  if (element.dataset.ranged) return;
  element.dataset.ranged = "true";
  whenActive(element, () =>
    element.on("plotly_relayout", (event) => {
      const range = rangeIn(event);
      const isTime = element._fullLayout.xaxis.type === "date";
      if (range !== undefined) callback(range && isTime ? range.map((end) => instantOf(end)) : range);
    }),
  );
}

/** Releases Plotly's resources of a plot. */
export function discard(element) {
  staticPlots.delete(element);
  if (element.layout) globalThis.Plotly.purge(element);
}

/** A vertical line over the whole plot. */
export function verticalLine(x, colour, dash = "solid", width = 1) {
  return {
    type: "line",
    xref: "x",
    yref: "paper",
    x0: x,
    x1: x,
    y0: 0,
    y1: 1,
    layer: "below",
    line: { color: colour, width, dash },
  };
}

/** A horizontal line over the whole plot, at a height on the axis. */
export const horizontalLine = (y, line) => ({
  type: "line",
  xref: "paper",
  x0: 0,
  x1: 1,
  y0: y,
  y1: y,
  line,
});

const stroke = (width, dashes) => (colour) =>
  svg("line", {
    x1: 1,
    x2: 23,
    y1: 7,
    y2: 7,
    stroke: colour,
    "stroke-width": width,
    "stroke-dasharray": dashes,
  });

const SWATCHES = {
  line: stroke(2.5),
  dash: stroke(2, "6 3"),
  dot: stroke(2.5, "2 3"),
  band: (colour) => svg("rect", { x: 1, y: 1, width: 22, height: 12, fill: colour }),
  octagon: (colour) => svg("path", { d: "M9.500 1.500h5L18 5v4l-3.500 3.500h-5L6 9V5z", fill: colour }),
  square: (colour) => svg("rect", { x: 7, y: 2, width: 10, height: 10, fill: colour }),
  circle: (colour) =>
    svg("circle", { cx: 12, cy: 7, r: 4.5, fill: "none", stroke: colour, "stroke-width": 2 }),
  filled: (colour) => svg("path", { d: "M12 1l6 6-6 6-6-6z", fill: colour }),
  cross: (colour) =>
    svg("path", { d: "M7.500 2.500l9 9M16.500 2.500l-9 9", stroke: colour, "stroke-width": 2.5 }),
  ticks: (colour) => svg("path", { d: "M4 3v8M9 3v8M14 3v8M19 3v8", stroke: colour, "stroke-width": 1.5 }),
  diamond: (colour) =>
    svg("path", { d: "M12 2l5 5-5 5-5-5z", fill: "none", stroke: colour, "stroke-width": 2 }),
};

/** A legend outside the plot, where it covers no data: `[swatch, colour, text]` each. */
export function legend(entries) {
  return entries.map(([swatch, colour, text]) =>
    h(
      "li",
      {},
      svg(
        "svg",
        { viewBox: "0 0 24 14", width: 24, height: 14, "aria-hidden": "true" },
        SWATCHES[swatch](colour),
      ),
      text,
    ),
  );
}
