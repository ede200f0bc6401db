// A previewed pair to scale: both whole gears, and the teeth in mesh; invalid parts in red.

import { h, setChildren, svg } from "./dom.js";
import { number } from "./format.js";
import { bodyPath, lostPath, partPath } from "./preview-teeth.js";

const REACH = 6; // teeth on each side of the line of centres
const ASPECT = 1.65; // width over height of the view of the teeth in mesh
const MAX_TEETH_DRAWN = 160; // whole gears with more teeth are drawn as circles
const degrees = (radians) => (radians * 180) / Math.PI;

/** The part of the tooth profile drawn red for each invalid measure. */
const PARTS = {
  undercut_margin: [0.02, 0.6],
  interference_margin: [0.02, 0.6],
  tip_thickness: [0.8, 1],
  tip_clearance: [0.8, 1],
  backlash: [0.5, 1],
};

/** The largest of 1, 2 and 5 times a power of ten that does not exceed a number. */
function roundBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((digit) => Number((digit * power).toPrecision(1))).find((round) => round <= value);
}

/** Angles at which the unworn teeth touch, at a fraction of the mesh period. */
function unwornAngles({ gears, measures }, start, part) {
  const [driving, driven] = gears;
  const backlash = measures.find(({ quantity }) => quantity === "backlash").value;
  const phi1 = start + (part * 2 * Math.PI) / driving.teeth;
  return [
    phi1,
    (phi1 * driving.teeth) / driven.teeth + Math.PI / driven.teeth - backlash / (2 * driven.pitch_radius_mm),
  ];
}

/**
 * The line of action: its foot on the driving base circle, its direction, and the start and end of contact.
 */
function lineOfAction({ gears: [driving], pressure_angle_deg: angle, measures }) {
  const alpha = (angle * Math.PI) / 180;
  const base = driving.base_radius_mm;
  const ratio = measures.find(({ quantity }) => quantity === "contact_ratio").value;
  const end = Math.sqrt(Math.max(0, driving.tip_radius_mm ** 2 - base ** 2));
  const pitch = (2 * Math.PI * base) / driving.teeth;
  return {
    foot: [base * Math.cos(alpha), -base * Math.sin(alpha)],
    along: [Math.sin(alpha), Math.cos(alpha)],
    start: end - ratio * pitch,
    end,
    pitch,
    alpha,
  };
}

/** The number of teeth drawn on each side of the line of centres. */
const reachOf = (gear) => Math.min(REACH, Math.floor((gear.teeth - 1) / 2));

/** The drawing of a pair; `turnTo(part)` rolls it through a mesh period. */
export class PairDrawing {
  #geometry;
  #drawn = "";
  #state;
  #wheels = [];
  #dots;
  #action;
  element = h("div", { class: "pair-drawing" });

  /** Shows why nothing is drawn. */
  showNotice(words) {
    this.#geometry = undefined;
    this.#drawn = "";
    setChildren(this.element, h("p", { class: "notice" }, words));
  }

  /** Draws a geometry, with worn flanks and the angles of a state when available. */
  show(geometry, flanks, state, part = 0.5) {
    this.#geometry = geometry;
    this.#state = state;
    this.#action = lineOfAction(geometry);
    // The gears are the same at every position of the wear slider
    const drawn = `${Boolean(flanks)} ${JSON.stringify(geometry)}`;
    if (drawn !== this.#drawn) setChildren(this.element, this.#whole(), this.#mesh(flanks));
    this.#drawn = drawn;
    this.#showLost(flanks);
    this.turnTo(part);
  }

  #bad(gear) {
    return this.#geometry.measures
      .filter((measure) => measure.verdict === "impossible" && (measure.gear ?? gear) === gear)
      .map(({ quantity }) => quantity);
  }

  #whole() {
    const { gears, centre_distance_mm: distance } = this.#geometry;
    const [left, right] = gears;
    const tall = Math.max(left.tip_radius_mm, right.tip_radius_mm);
    const [low, high] = [-left.tip_radius_mm, distance + right.tip_radius_mm];
    const pad = 0.02 * (high - low);
    const turn = unwornAngles(this.#geometry, 0, 0);
    const wheel = (gear, index) => {
      const bad = this.#bad(index + 1);
      const body =
        gear.teeth <= MAX_TEETH_DRAWN
          ? svg("path", {
              class: "wheel-body",
              d: bodyPath(gear, 0, gear.teeth - 1, 6),
              transform: `rotate(${degrees(turn[index])})`,
            })
          : svg(
              "g",
              {},
              svg("circle", { class: "wheel-body", r: gear.tip_radius_mm }),
              svg("circle", { class: "wheel-pitch", r: gear.root_radius_mm }),
            );
      return svg(
        "g",
        {
          transform: `translate(${index ? distance : 0} 0) scale(${index ? -1 : 1} -1)`,
          class: bad.length ? "wheel wheel-bad" : "wheel",
        },
        body,
        svg("circle", { class: "wheel-pitch", r: gear.pitch_radius_mm }),
        svg("circle", {
          class: bad.includes("root_to_bore") ? "wheel-bore drawn-bad" : "wheel-bore",
          r: gear.bore_radius_mm,
        }),
      );
    };
    const words = `Driving gear with ${left.teeth} teeth, driven gear with ${right.teeth}, centre distance ${number(distance, 5)} mm, drawn to scale`;
    return h(
      "figure",
      { class: "whole-pair" },
      svg(
        "svg",
        {
          viewBox: `${low - pad} ${-tall - pad} ${high - low + 2 * pad} ${2 * tall + 2 * pad}`,
          role: "img",
          "aria-label": words,
        },
        wheel(left, 0),
        wheel(right, 1),
      ),
      h(
        "figcaption",
        { class: "muted" },
        `Left: driving, ${left.teeth} teeth; right: driven, ${right.teeth} teeth. Overall width ${number(high - low, 4)} mm, centre distance ${number(distance, 5)} mm.`,
      ),
    );
  }

  /** Draws the wear of the working flanks below the red parts. */
  #showLost(flanks) {
    this.#wheels.forEach((teeth, index) => {
      const gear = this.#geometry.gears[index];
      const to = reachOf(gear);
      teeth.querySelector(".mesh-lost")?.remove();
      if (flanks?.[index].depth_um.some((depth) => depth > 0))
        teeth.firstChild.after(
          svg("path", { class: "mesh-lost", d: lostPath(gear, flanks[index], index ? -1 : 1, -to, to) }),
        );
    });
  }

  #mesh(flanks) {
    const { gears, centre_distance_mm: distance } = this.#geometry;
    const [driving] = gears;
    const tall = 1.3 * Math.max(...gears.map((gear) => gear.tip_radius_mm - gear.root_radius_mm));
    const wide = ASPECT * tall;
    const middle = -driving.pitch_radius_mm;
    this.#wheels = gears.map((gear, index) => {
      const to = reachOf(gear);
      const from = -to;
      const bad = this.#bad(index + 1);
      const teeth = svg(
        "g",
        {},
        svg("path", {
          class: index ? "mesh-body mesh-driven" : "mesh-body mesh-driving",
          d: bodyPath(gear, from, to),
        }),
      );
      for (const quantity of bad.filter((quantity) => PARTS[quantity]))
        teeth.append(svg("path", { class: "drawn-bad", d: partPath(gear, ...PARTS[quantity], from, to) }));
      return teeth;
    });
    const placed = this.#wheels.map((teeth, index) =>
      svg("g", { transform: `translate(${index ? distance : 0} 0) scale(${index ? -1 : 1} -1)` }, teeth),
    );
    const pitch = gears.map((gear, index) =>
      svg("circle", { class: "mesh-pitch", cx: index ? distance : 0, r: gear.pitch_radius_mm }),
    );
    const { foot, along, start, end } = this.#action;
    const at = (length) => [foot[0] + length * along[0], -(foot[1] + length * along[1])];
    const [[x1, y1], [x2, y2]] = [at(start), at(end)];
    const without = this.#bad(1).includes("contact_ratio");
    this.#dots = svg("g", { class: "mesh-dots" });
    const scale = roundBelow(wide / 2);
    const [left, bottom] = [-0.94 * wide, middle + 0.91 * tall];
    return h(
      "figure",
      { class: "mesh-close" },
      svg(
        "svg",
        {
          viewBox: `${-wide} ${middle - tall} ${2 * wide} ${2 * tall}`,
          role: "img",
          "aria-label": `Teeth in mesh to scale${flanks ? ", with the wear of the working flanks" : ""}`,
        },
        // The line of centres is upright, so that teeth are side by side
        svg(
          "g",
          { transform: "matrix(0 -1 -1 0 0 0)" },
          placed,
          pitch,
          svg("line", { class: without ? "mesh-action drawn-bad" : "mesh-action", x1, y1, x2, y2 }),
          this.#dots,
        ),
        svg("line", { class: "tooth-scale", x1: left, x2: left + scale, y1: bottom, y2: bottom }),
        svg(
          "text",
          { class: "tooth-text", x: left, y: bottom - 0.05 * tall, "font-size": tall / 10 },
          `${scale} mm`,
        ),
      ),
      h(
        "figcaption",
        { class: "muted" },
        "To scale; the lower gear drives to the right. Line: path of contact. Dashed: pitch circles.",
      ),
    );
  }

  /** Rolls the teeth to a fraction of the mesh period. */
  turnTo(part) {
    if (!this.#geometry) return;
    const [driving] = this.#geometry.gears;
    const { foot, along, start, end, pitch, alpha } = this.#action;
    const nominal = start / driving.base_radius_mm - this.#halfAngle() - alpha;
    const place = this.#state
      ? Math.min(this.#state.phi1_rad.length - 1, Math.floor(part * this.#state.phi1_rad.length))
      : 0;
    const angles = this.#state
      ? [this.#state.phi1_rad[place], this.#state.phi2_rad[place]]
      : unwornAngles(this.#geometry, nominal, part);
    this.#wheels.forEach((teeth, index) =>
      teeth.setAttribute("transform", `rotate(${degrees(angles[index])})`),
    );
    const dots = [];
    for (let length = start + part * pitch; length <= end; length += pitch)
      dots.push(
        svg("circle", { cx: foot[0] + length * along[0], cy: -(foot[1] + length * along[1]), r: pitch / 24 }),
      );
    this.#dots.replaceChildren(...dots);
  }

  /** Half of the driving tooth's angle at the base circle in rad, from its thickness at the tip. */
  #halfAngle() {
    const [driving] = this.#geometry.gears;
    const [x, y] = driving.profile_mm.at(-1);
    const pressure = Math.acos(Math.min(1, driving.base_radius_mm / Math.hypot(x, y)));
    return Math.atan2(y, x) + Math.tan(pressure) - pressure;
  }
}
