// Small drawings without axes: the wear bar with its limits, and the sparkline of the wear history.

import { h, svg } from "./dom.js";
import { depth } from "./format.js";
import { depthWords, isUsable, wearState } from "./state.js";

const DANGER_AT = 0.8; // position of the danger limit, the same in every bar so that bars are comparable

function scaleEnd(wear, limits) {
  const high = wear?.high_um ?? 0;
  if (limits?.danger_um) return Math.max(limits.danger_um / DANGER_AT, high);
  if (limits?.warning_um) return Math.max(limits.warning_um / 0.6, high);
  return Math.max(high * 1.2, 10);
}

function place(element, from, to) {
  element.style.left = `${100 * from}%`;
  if (to !== undefined) element.style.width = `${100 * Math.max(to - from, 0.008)}%`;
  return element;
}

/**
 * Interval as a band, median as a line, limits as marked lines; with a text description for screen readers.
 */
export function wearBar(wear, limits) {
  const bar = h("div", { class: "wear-bar", role: "img", "aria-label": describe(wear, limits) });
  const end = scaleEnd(wear, limits);
  const { warning_um: warning, danger_um: danger } = limits ?? {};
  if (warning != null)
    bar.append(place(h("span", { class: "zone zone-warning" }), warning / end, (danger ?? end) / end));
  if (danger != null) bar.append(place(h("span", { class: "zone zone-danger" }), danger / end, 1));
  if (wear?.median_um != null) {
    bar.dataset.state = wearState(wear, limits);
    bar.append(place(h("span", { class: "interval" }), wear.low_um / end, Math.min(wear.high_um / end, 1)));
    if (isUsable(wear))
      bar.append(place(h("span", { class: "median" }), Math.min(wear.median_um / end, 0.995)));
  }
  if (warning != null)
    bar.append(
      place(
        h("span", { class: "limit limit-warning", title: `warning limit ${depth(warning)} µm` }),
        warning / end,
      ),
    );
  if (danger != null)
    bar.append(
      place(
        h("span", { class: "limit limit-danger", title: `danger limit ${depth(danger)} µm` }),
        danger / end,
      ),
    );
  return bar;
}

function describe(wear, limits) {
  const number =
    wear?.median_um == null ? "no wear estimate" : `wear ${Object.values(depthWords(wear)).join(", ")}`;
  const limit = (name, value) => (value == null ? "" : `, ${name} limit ${depth(value)} µm`);
  return number + limit("warning", limits?.warning_um) + limit("danger", limits?.danger_um);
}

/** The wear history as a line from zero; the danger limit is dashed when it is near. */
export function sparkline(values, limits, width = 120, height = 32) {
  const drawing = svg("svg", {
    class: "sparkline",
    viewBox: `0 0 ${width} ${height}`,
    width,
    height,
    "aria-hidden": "true",
  });
  if (!values || values.length < 2) return drawing;
  const danger = limits?.danger_um;
  const top = Math.max(...values, danger ?? 0) * 1.08 || 1;
  const y = (value) => height - 2 - (value / top) * (height - 4);
  const x = (index) => 2 + (index / (values.length - 1)) * (width - 6);
  const points = values.map((value, index) => `${x(index).toFixed(1)},${y(value).toFixed(1)}`);
  if (danger != null)
    drawing.append(svg("line", { class: "spark-limit", x1: 0, x2: width, y1: y(danger), y2: y(danger) }));
  drawing.append(
    svg("polygon", {
      class: "spark-area",
      points: `${x(0)},${y(0)} ${points.join(" ")} ${x(values.length - 1)},${y(0)}`,
    }),
    svg("polyline", { class: "spark-line", points: points.join(" ") }),
    svg("circle", { class: "spark-end", cx: x(values.length - 1), cy: y(values.at(-1)), r: 2.5 }),
  );
  return drawing;
}

/** Progress of the baseline, as a bar with numbers. */
export function baselineBar({ have, need }) {
  const label = `Baseline ${have} of ${need} records`;
  return h(
    "div",
    { class: "baseline" },
    h("progress", { max: need, value: have, "aria-label": label }),
    h("span", {}, `${have} of ${need}`),
  );
}
