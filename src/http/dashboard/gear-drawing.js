// Draws a gear pair to scale: involute teeth from the basic data, in mesh at the centre distance.

import { h, setChildren, svg } from "./dom.js";
import { number } from "./format.js";

const POINTS = 9;

/** The bore radius of a gear whose bore is not given, as part of its root radius; the presets have 0.2 to 0.37. */
export const USUAL_BORE = 1 / 3;

const involute = (angle) => Math.tan(angle) - angle;

/** Radii in mm and angles of one gear of a pair; null when the numbers do not define a gear. */
function resolve(
  {
    teeth,
    module_mm: module,
    pressure_angle_deg: angle = 20,
    addendum = [1, 1],
    dedendum = [1.25, 1.25],
    profile_shift: shift = [0, 0],
    bore_radius_mm: bore,
  },
  index,
) {
  const z = Number(teeth?.[index]);
  const alpha = (Number(angle) * Math.PI) / 180;
  const reference = (Number(module) * z) / 2;
  if (!(z >= 3 && reference > 0 && alpha > 0 && alpha < 1)) return null;
  const base = reference * Math.cos(alpha);
  const x = Number(shift[index]);
  const root = reference - (Number(dedendum[index]) - x) * module;
  return {
    teeth: z,
    base,
    reference,
    tip: reference + (Number(addendum[index]) + x) * module,
    root,
    bore: Number(bore?.[index] ?? USUAL_BORE * root),
    half: Math.PI / 2 / z + involute(alpha) + (2 * x * Math.tan(alpha)) / z,
  };
}

/** The outline of one gear around (0, 0), with a tooth on the positive x axis rotated by `turn`. */
function outline(gear, turn) {
  const flank = [];
  const start = Math.max(gear.base, gear.root);
  for (let n = 0; n < POINTS; n++) {
    const radius = start + ((gear.tip - start) * n) / (POINTS - 1);
    const at = Math.acos(Math.min(1, gear.base / radius));
    flank.push([radius, gear.half - involute(at)]);
  }
  const points = [];
  for (let tooth = 0; tooth < gear.teeth; tooth++) {
    const centre = turn + (2 * Math.PI * tooth) / gear.teeth;
    const lower = [[gear.root, -flank[0][1]], ...flank.map(([radius, angle]) => [radius, -angle])];
    const upper = [...lower].reverse().map(([radius, angle]) => [radius, -angle]);
    for (const [radius, angle] of [...lower, ...upper])
      points.push([radius * Math.cos(centre + angle), radius * Math.sin(centre + angle)]);
  }
  return `M${points.map(([x, y]) => `${x.toFixed(2)} ${y.toFixed(2)}`).join("L")}Z`;
}

function wheel(gear, x, turn, name) {
  return svg(
    "g",
    { transform: `translate(${x.toFixed(3)} 0)`, class: "wheel" },
    svg("path", { class: "wheel-body", d: outline(gear, turn) }),
    svg("circle", { class: "wheel-pitch", r: gear.reference }),
    gear.bore > 0 ? svg("circle", { class: "wheel-bore", r: gear.bore }) : null,
    svg(
      "text",
      {
        class: "wheel-text",
        "text-anchor": "middle",
        y: gear.bore + (gear.root - gear.bore) / 2,
        "font-size": gear.reference / 7,
      },
      `${name}, ${gear.teeth} teeth`,
    ),
  );
}

/** Draws a pair's basic data into an element, or says what is missing. */
export function drawPair(element, geometry) {
  const gears = [resolve(geometry, 0), resolve(geometry, 1)];
  if (!gears[0] || !gears[1])
    return setChildren(
      element,
      h("p", { class: "notice" }, "Tooth counts and module are needed to draw the gears."),
    );
  const distance = Number(geometry.centre_distance_mm) || gears[0].reference + gears[1].reference;
  const [left, right] = gears;
  const [low, high] = [-left.tip, distance + right.tip];
  const tall = Math.max(left.tip, right.tip);
  const pad = 0.02 * (high - low);
  // A tooth of the driving gear lies on the line of centres, opposite a gap of the driven gear
  const turn = Math.PI + Math.PI / right.teeth;
  const bar = 10 ** Math.floor(Math.log10((high - low) / 3));
  const words = `Driving gear with ${left.teeth} teeth, driven gear with ${right.teeth}, centre distance ${number(distance, 5)} mm, drawn to scale`;
  return setChildren(
    element,
    svg(
      "svg",
      {
        viewBox: `${low - pad} ${-tall - pad} ${high - low + 2 * pad} ${2 * tall + 2 * pad}`,
        role: "img",
        "aria-label": words,
      },
      wheel(left, 0, 0, "driving"),
      wheel(right, distance, turn, "driven"),
      svg("line", { class: "tooth-scale", x1: low, x2: low + bar, y1: tall, y2: tall }),
      svg(
        "text",
        { class: "tooth-text", x: low, y: tall - pad, "font-size": (high - low) / 38 },
        `${bar} mm`,
      ),
    ),
    h(
      "p",
      { class: "muted" },
      `${words}; tip circles ${number(2 * left.tip, 5)} and ${number(2 * right.tip, 5)} mm across.`,
    ),
  );
}
