// A plot drawn without the plotting library, as SVG from the same traces and layout: axes, curves, shapes and
// labels at the places where Plotly draws them.

import { svg } from "./dom.js";
import { axesOf, coordinate, TICK } from "./static-axes.js";
import { curvesOf, drawnCurve, isDrawable, stroke } from "./static-curves.js";
import { annotationBox, LINE, linesOf } from "./static-text.js";

const TYPES = [undefined, "linear", "log", "date"];

/** Whether traces and layout have only what is drawn here. */
function isWithin(traces, layout) {
  const axes = Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key));
  return (
    axes.includes("xaxis") &&
    axes.includes("yaxis") &&
    axes.every((key) => {
      const { type, autorange, matches, exponentformat: exponents = "none" } = layout[key];
      return TYPES.includes(type) && !autorange && !matches && exponents === "none";
    }) &&
    traces.every(isDrawable)
  );
}

/** Shows children only within a part of the picture, which keeps its coordinates. */
const clipped = ({ x, y, width, height }, children) =>
  svg("svg", { x, y, width, height, viewBox: `${x} ${y} ${width} ${height}` }, children);

function write(lines, { x, y, size, colour, anchor = "middle" }) {
  const rest = lines.slice(1).map((line) => svg("tspan", { x, dy: LINE * size }, line));
  return svg("text", { x, y, fill: colour, "font-size": size, "text-anchor": anchor }, lines[0], rest);
}

/** One plot: its axes, and what is drawn on them. */
class Picture {
  #layout;
  #axes;
  #size;
  #frame;
  #curves;

  constructor(curves, layout, frame) {
    [this.#curves, this.#layout, this.#frame] = [curves, layout, frame];
    const { axes, size } = axesOf(curves, layout, frame, (each) => annotationBox(each, layout.font));
    [this.#axes, this.#size] = [axes, size];
  }

  #all(letter) {
    return Object.values(this.#axes).filter((axis) => axis.letter === letter);
  }

  /** A position of a shape or label: on its axis, or as a fraction of the plot. */
  #at(letter, ref = letter, value = 0, isLogarithm = false) {
    const { l, t, w, h } = this.#size;
    if (ref === "paper") return letter === "x" ? l + w * value : t + h * (1 - value);
    const axis = this.#axes[ref];
    return axis.at(isLogarithm && axis.type === "log" ? value : coordinate(axis.type, value));
  }

  #grid() {
    const { l, w } = this.#size;
    const lines = [];
    const line = (spec, isZero, d) =>
      lines.push(svg("path", { d, stroke: isZero ? spec.zerolinecolor : spec.gridcolor, "stroke-width": 1 }));
    const isZero = ({ type }, at) => type === "linear" && at === 0;
    for (const x of this.#all("x"))
      for (const y of this.#all("y").filter(({ spec }) => (spec.anchor ?? "x") === x.id))
        for (const { at } of x.ticks) line(x.spec, isZero(x, at), `M${x.at(at)} ${y.offset}v${y.length}`);
    for (const y of this.#all("y"))
      for (const { at } of y.ticks) line(y.spec, isZero(y, at), `M${l} ${y.at(at)}h${w}`);
    return svg("g", { "shape-rendering": "crispEdges" }, lines);
  }

  #shape(shape) {
    const place = (letter, end) =>
      shape[`${letter}sizemode`] === "pixel"
        ? this.#at(letter, shape[`${letter}ref`], shape[`${letter}anchor`]) +
          (letter === "x" ? shape[end] : -shape[end])
        : this.#at(letter, shape[`${letter}ref`], shape[end]);
    const paint = { ...stroke(shape.line ?? {}), ...(shape.fillcolor && { fill: shape.fillcolor }) };
    if (shape.type === "path") {
      const [x, y] = [this.#at("x", shape.xref, shape.xanchor), this.#at("y", shape.yref, shape.yanchor)];
      return svg("path", { d: shape.path, transform: `translate(${x} ${y}) scale(1 -1)`, ...paint });
    }
    const [x0, x1, y0, y1] = [place("x", "x0"), place("x", "x1"), place("y", "y0"), place("y", "y1")];
    if (shape.type === "line") return svg("path", { d: `M${x0} ${y0}L${x1} ${y1}`, ...paint });
    const [width, height] = [Math.abs(x1 - x0), Math.abs(y1 - y0)];
    if (shape.type === "circle")
      return svg("ellipse", {
        cx: (x0 + x1) / 2,
        cy: (y0 + y1) / 2,
        rx: width / 2,
        ry: height / 2,
        ...paint,
      });
    return svg("rect", { x: Math.min(x0, x1), y: Math.min(y0, y1), width, height, ...paint });
  }

  /** Shapes below or above the curves, each within the axes that it refers to. */
  #shapes(isBelow) {
    const { width, height } = this.#frame;
    return (this.#layout.shapes ?? [])
      .filter(({ layer }) => (layer === "below") === isBelow)
      .map((shape) => {
        const [x, y] = [this.#axes[shape.xref ?? "x"], this.#axes[shape.yref ?? "y"]];
        const area = {
          x: x?.offset ?? 0,
          y: y?.offset ?? 0,
          width: x?.length ?? width,
          height: y?.length ?? height,
        };
        return clipped(area, [this.#shape(shape)]);
      });
  }

  #drawnCurves() {
    return this.#curves
      .filter(({ trace }) => trace.opacity !== 0)
      .map((curve) => {
        const axes = { x: this.#axes[curve.x.id], y: this.#axes[curve.y.id] };
        const drawn = drawnCurve(curve, axes).filter(Boolean);
        if (curve.trace.cliponaxis === false) return svg("g", {}, drawn);
        const { x, y } = axes;
        return clipped({ x: x.offset, y: y.offset, width: x.length, height: y.length }, drawn);
      });
  }

  #axis(axis) {
    const { letter, spec, offset, length, at, ticks, depth } = axis;
    if (spec.visible === false) return null;
    const { l } = this.#size;
    const { size, color: colour } = this.#layout.font;
    const anchor = this.#axes[spec.anchor ?? (letter === "x" ? "y" : "x")];
    const edge = letter === "x" ? anchor.offset + anchor.length : l;
    const isX = letter === "x";
    const d = [
      isX ? `M${offset - 1} ${edge + 0.5}H${offset + length}` : `M${edge - 0.5} ${offset}V${offset + length}`,
      ...ticks.map(({ at: value }) =>
        isX ? `M${at(value)} ${edge + 1}v${TICK.length}` : `M${edge - 1} ${at(value)}h${-TICK.length}`,
      ),
    ];
    const gap = TICK.length + 0.2 * size + TICK.width;
    const labels = ticks.map(({ at: value, words, more }) =>
      isX
        ? write([words, more].filter(Boolean), { x: at(value), y: edge + gap + size, size, colour })
        : write([words], { x: edge - gap, y: at(value) + 0.35 * size, size, colour, anchor: "end" }),
    );
    const titleSize = Math.round(1.2 * size);
    const beyond = depth + (spec.title?.standoff ?? 0) + (isX ? 0.7 : 0.3) * titleSize;
    const middle = offset + length / 2;
    const title = spec.title?.text
      ? write(linesOf(spec.title.text), {
          x: isX ? middle : edge - beyond,
          y: isX ? edge + beyond : middle,
          size: titleSize,
          colour,
        })
      : null;
    if (title && !isX) title.setAttribute("transform", `rotate(-90 ${edge - beyond} ${middle})`);
    return svg(
      "g",
      { "data-axis": axis.id },
      svg("path", { d: d.join(""), "shape-rendering": "crispEdges", stroke: spec.linecolor, fill: "none" }),
      labels,
      title,
    );
  }

  #label(annotation) {
    const { font } = this.#layout;
    const box = annotationBox(annotation, font);
    const x = this.#at("x", annotation.xref, annotation.x, true) + (annotation.xshift ?? 0);
    const y = this.#at("y", annotation.yref, annotation.y, true) - (annotation.yshift ?? 0);
    if (!this.#isInView(annotation)) return null;
    const [left, top] = [Math.round(x - box.x.before), Math.round(y - box.y.after)];
    const [across, upright] = [box.x.before + box.x.after, box.y.before + box.y.after];
    const [middle, centre] = [left + across / 2, top + upright / 2];
    const corner = { x: middle - box.width / 2, y: centre - box.height / 2 };
    return svg(
      "g",
      { transform: annotation.textangle ? `rotate(${annotation.textangle} ${middle} ${centre})` : null },
      annotation.bgcolor &&
        svg("rect", { ...corner, width: box.width, height: box.height, fill: annotation.bgcolor }),
      write(box.lines, {
        x: middle,
        y: corner.y + box.edge + box.ascent,
        size: box.size,
        colour: annotation.font?.color ?? font.color,
      }),
    );
  }

  /** Labels beyond the ends of their axes are left out. */
  #isInView(annotation) {
    return ["x", "y"].every((letter) => {
      const axis = this.#axes[annotation[`${letter}ref`] ?? letter];
      if (!axis) return true;
      const at = this.#at(letter, axis.id, annotation[letter], true);
      return at >= axis.offset - 0.5 && at <= axis.offset + axis.length + 0.5;
    });
  }

  draw() {
    const { width, height } = this.#frame;
    const { family } = this.#layout.font;
    return svg(
      "svg",
      {
        class: "static",
        width,
        height,
        viewBox: `0 0 ${width} ${height}`,
        "font-family": family,
        "aria-hidden": "true",
      },
      this.#grid(),
      this.#shapes(true),
      this.#drawnCurves(),
      Object.values(this.#axes).map((axis) => this.#axis(axis)),
      this.#shapes(false),
      (this.#layout.annotations ?? []).map((annotation) => this.#label(annotation)),
    );
  }
}

/**
 * Draws traces and a layout with all its defaults in a frame of pixels; null when that needs the library.
 * @returns {SVGElement | null}
 */
export function staticPlot(traces, layout, frame) {
  if (!isWithin(traces, layout) || !frame.width || !frame.height) return null;
  return new Picture(curvesOf(traces, layout), layout, frame).draw();
}
