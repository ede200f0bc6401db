// The curves of a plot that is drawn without the plotting library: lines, bands, markers and error bars.

import { svg } from "./dom.js";
import { coordinate } from "./static-axes.js";

const FILLS = [undefined, "toself", "tozeroy"];

/** Outlines around a place, by the radius `r` of the marker. */
const SYMBOLS = {
  circle: (r) => `m${-r} 0a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`,
  diamond: (r) => `m${1.3 * r} 0l${-1.3 * r} ${1.3 * r}l${-1.3 * r} ${-1.3 * r}l${1.3 * r} ${-1.3 * r}z`,
  "line-ns": (r) => `m0 ${1.4 * r}v${-2.8 * r}`,
};

const symbolOf = ({ symbol = "circle" } = {}) => symbol.replace("-open", "");

/** Whether a trace has only what is drawn here. */
export const isDrawable = ({ type = "scatter", fill, mode, marker, error_x: across }) =>
  type === "scatter" && Boolean(mode) && FILLS.includes(fill) && symbolOf(marker) in SYMBOLS && !across;

/** Plotly's dashes, which grow with the width of the line. */
function dashes(dash, width) {
  const unit = Math.max(width, 3);
  const lengths = { dot: [1, 1], dash: [3, 3], dashdot: [3, 1, 1, 1] }[dash];
  return lengths && lengths.map((length) => length * unit).join(" ");
}

/** How a line is drawn. */
export const stroke = ({ color, width = 2, dash = undefined }) => ({
  fill: "none",
  stroke: color,
  "stroke-width": width,
  "stroke-dasharray": dashes(dash, width),
});

/** A place in the picture; a tenth of a pixel is enough. */
const px = (value) => Math.round(10 * value) / 10;

/** Stretches of points without gaps, each a text of a path. */
function stretches(xs, ys, { x, y }) {
  const parts = [];
  let part = [];
  const end = () => {
    if (part.length) parts.push(part);
    part = [];
  };
  for (let n = 0; n < xs.length; n++) {
    const place = [x.at(xs[n]), y.at(ys[n])];
    if (place.every(Number.isFinite)) part.push(`${px(place[0])} ${px(place[1])}`);
    else end();
  }
  end();
  return parts;
}

function filled(curve, axes) {
  const { trace } = curve;
  const floor = px(axes.y.at(axes.y.type === "log" ? axes.y.range[0] : 0));
  const foot = (point) => `${point.split(" ")[0]} ${floor}`;
  const d = stretches(curve.x.values, curve.y.values, axes)
    .map((part) => (trace.fill === "toself" ? part : [foot(part[0]), ...part, foot(part.at(-1))]))
    .map((part) => `M${part.join("L")}Z`)
    .join("");
  return svg("path", { d, fill: trace.fillcolor });
}

function markers(curve, axes) {
  const { marker = {}, line = {} } = curve.trace;
  const [size, colour] = [marker.size ?? 6, marker.color ?? line.color];
  const outline = SYMBOLS[symbolOf(marker)](size / 2);
  const isOpen = marker.symbol?.endsWith("-open");
  const width = marker.line?.width ?? (isOpen ? 1 : 0);
  const d = stretches(curve.x.values, curve.y.values, axes)
    .flat()
    .map((place) => `M${place}${outline}`)
    .join("");
  return svg("path", {
    d,
    fill: isOpen ? "none" : colour,
    stroke: width ? colour : null,
    "stroke-width": width,
  });
}

/** Error bars with caps. */
function errors({ trace: { error_y: bars }, x, y }, axes) {
  const d = x.values.flatMap((value, n) => {
    const [at, low, high] = [
      axes.x.at(value),
      axes.y.at(y.values[n] - bars.array[n]),
      axes.y.at(y.values[n] + bars.array[n]),
    ].map(px);
    if (![at, low, high].every(Number.isFinite)) return [];
    const cap = (end) => `M${at - bars.width} ${end}h${2 * bars.width}`;
    return [`M${at} ${low}V${high}${cap(low)}${cap(high)}`];
  });
  return svg("path", { d: d.join(""), ...stroke({ color: bars.color, width: bars.thickness }) });
}

/** A curve as elements, which may be missing. */
export function drawnCurve(curve, axes) {
  const { trace } = curve;
  const { mode, line = {}, error_y: bars, fill } = trace;
  const isLine = mode.includes("lines") && line.width !== 0;
  return [
    fill && filled(curve, axes),
    bars && errors(curve, axes),
    isLine &&
      svg("path", {
        d: stretches(curve.x.values, curve.y.values, axes)
          .map((part) => `M${part.join("L")}`)
          .join(""),
        ...stroke(line),
      }),
    mode.includes("markers") && markers(curve, axes),
  ];
}

/** The values of traces on their axes. */
export function curvesOf(traces, layout) {
  const known = new Map(); // panes share their times
  const on = (letter, id = letter, values = []) => {
    const type = layout[id.replace(letter, `${letter}axis`)].type ?? "linear";
    if (!known.has(values)) known.set(values, new Map());
    const converted = known.get(values);
    if (!converted.has(type))
      converted.set(
        type,
        Array.from(values, (value) => coordinate(type, value)),
      );
    return { id, values: converted.get(type) };
  };
  return traces.map((trace) => ({
    trace,
    x: on("x", trace.xaxis, trace.x),
    y: on("y", trace.yaxis, trace.y),
  }));
}
