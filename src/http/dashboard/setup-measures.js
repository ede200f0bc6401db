// The measures that decide whether a pair's teeth can mesh, each with a verdict.

import { h, setChildren } from "./dom.js";
import { number } from "./format.js";

const WORDS = {
  contact_ratio: ["Contact ratio", "", "at least 1, usually above 1.2"],
  backlash: ["Backlash", "mm", "at least 0, otherwise the teeth jam"],
  tip_clearance: ["Tip clearance", "modules", "above 0, usually 0.25"],
  tip_thickness: ["Tip thickness", "modules", "at least 0.1, usually above 0.2"],
  undercut_margin: ["Undercut margin", "modules of profile shift", "at least 0"],
  interference_margin: ["Interference margin", "mm", "at least 0, otherwise the tip touches the fillet"],
  root_to_bore: ["Root over bore radius", "", "at least 1.4"],
  load: ["Load on the teeth", "% of the model's limit", "at most 100"],
};
const SIGNS = { good: "✓", marginal: "!", impossible: "✕" };
const GEARS = ["", "driving", "driven"];
const RANK = { impossible: 0, marginal: 1, good: 2 };

function shown({ quantity, value }) {
  const scaled = quantity === "load" ? 100 * value : value;
  return number(Math.abs(scaled) < 5e-7 ? 0 : scaled, 3);
}

/** Lists the measures of a geometry, impossible ones first. */
export function showMeasures(element, measures) {
  // Equal values of both gears share a line
  const rows = Object.keys(WORDS)
    .map((quantity) => {
      const own = measures.filter((measure) => measure.quantity === quantity);
      const verdict = own.reduce(
        (worst, measure) => (RANK[measure.verdict] < RANK[worst] ? measure.verdict : worst),
        "good",
      );
      return { quantity, own, verdict };
    })
    .filter(({ own }) => own.length);
  rows.sort((a, b) => RANK[a.verdict] - RANK[b.verdict]);
  const row = ({ quantity, own, verdict }) => {
    const [name, unit, limit] = WORDS[quantity];
    const values = own.map((measure) =>
      h(
        "span",
        { class: measure.verdict === "impossible" ? "measure-bad" : null },
        `${measure.gear ? `${GEARS[measure.gear]} ` : ""}${shown(measure)}`,
      ),
    );
    return h(
      "li",
      { "data-verdict": verdict, "data-quantity": quantity },
      h("span", { class: "measure-sign", role: "img", "aria-label": verdict }, SIGNS[verdict]),
      h("span", {}, name),
      h(
        "span",
        { class: "measure-values" },
        values.flatMap((value, n) => (n ? [", ", value] : [value])),
        unit ? ` ${unit}` : "",
      ),
      verdict === "good" ? null : h("span", { class: "muted measure-limit" }, limit),
    );
  };
  return setChildren(element, rows.map(row));
}
