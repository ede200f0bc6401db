// Draws a tooth of each gear with the wear of its working flank, exaggerated by the stated factor.

import { h, setChildren, setText, svg } from "./dom.js";
import { depth, number } from "./format.js";

const SHOWN_MM = 0.9; // drawn width of the deepest wear, in mm of the tooth
const MARGIN = 0.6;
const SCALE_MM = 2.9; // room for the scale and its words beside the tooth

const path = (points, close = false) =>
  `M${points.map(([x, y]) => `${x.toFixed(3)} ${y.toFixed(3)}`).join("L")}${close ? "Z" : ""}`;

/** One tooth: vertical centre line, tip on top, worn flank on the right. */
function tooth(
  {
    teeth,
    root_radius_mm: root,
    tip_radius_mm: tip,
    pitch_radius_mm: pitch,
    x_mm: xs,
    y_mm: ys,
    depth_um: depths,
  },
  exaggeration,
  name,
) {
  const flank = xs.map((x, n) => [ys[n], -x]);
  const worn = xs.map((x, n) => [ys[n] - (depths[n] / 1000) * exaggeration, -x]);
  const foot = [flank[0][0] * 1.08, -root];
  const mirrored = [...flank, foot].map(([x, y]) => [-x, y]);
  const outline = [foot, ...flank, ...mirrored.slice(0, -1).reverse(), mirrored.at(-1)];
  const half = foot[0] + MARGIN;
  const lost = [...flank, ...[...worn].reverse()];
  const left = half + SCALE_MM;
  const box = `${-left} ${-tip - MARGIN} ${2 * left} ${tip - root + 2 * MARGIN}`;
  const deepest = Math.max(...depths);
  const where = depths.indexOf(deepest);
  return h(
    "div",
    { class: "tooth" },
    svg(
      "svg",
      {
        viewBox: box,
        role: "img",
        "aria-label": `${name}, ${teeth} teeth: deepest wear ${depth(deepest)} µm at a radius of ${number(Math.hypot(xs[where], ys[where]), 4)} mm`,
      },
      svg("path", { class: "tooth-body", d: path(outline, true) }),
      svg("path", { class: "tooth-lost", d: path(lost, true) }),
      svg("path", { class: "tooth-unworn", d: path(flank) }),
      svg("path", { class: "tooth-worn", d: path(worn) }),
      svg("line", { class: "tooth-pitch", x1: -half - 1, x2: half + 1, y1: -pitch, y2: -pitch }),
      svg("line", { class: "tooth-scale", x1: -half - 0.3, x2: -half - 0.3, y1: -root - 2, y2: -root }),
      svg(
        "text",
        { class: "tooth-text", "font-size": 0.75, x: -half - 0.5, y: -root - 0.75, "text-anchor": "end" },
        "2 mm",
      ),
    ),
    h("p", { class: "muted" }, `${name}, ${teeth} teeth: deepest ${depth(deepest)} µm`),
  );
}

/** The card of the flanks. */
export class FlankCard {
  #sub = h("p", { class: "muted plot-sub" });
  #teeth = h("div", { class: "teeth" });
  element;

  constructor(title = "Flanks at the estimated wear") {
    this.element = h(
      "figure",
      { class: "card plot-card", "data-plot": "flank" },
      h("figcaption", {}, h("h2", {}, title), this.#sub),
      this.#teeth,
    );
  }

  /** Shows the flanks of a response, or its error. */
  show(flank, match) {
    if (flank instanceof Error) {
      setText(this.#sub, flank.message);
      return setChildren(this.#teeth);
    }
    const { gears, wear_um: wear } = flank;
    const exaggeration = wear > 0.5 ? Math.max(1, Math.round(SHOWN_MM / (wear / 1000))) : 1;
    setText(
      this.#sub,
      `Wear depth exaggerated ${exaggeration} × (red); the tooth is to scale. Dashed: pitch circle, where the teeth roll. Greatest depth ${depth(match.wear_um)} µm, with the wear profile of the gear pair.`,
    );
    return setChildren(
      this.#teeth,
      gears.map((gear, index) => tooth(gear, exaggeration, index ? "Driven gear" : "Driving gear")),
    );
  }
}
