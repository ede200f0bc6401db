// The gear pair beside the form: drawn to scale, its measures, and errors that no field of the form has.

import { h, setChildren } from "./dom.js";
import { PairDrawing } from "./preview-drawing.js";
import { showMeasures } from "./setup-measures.js";

/** The card of the pair's geometry. */
export class PairGeometry {
  #drawing = new PairDrawing();
  #faults = h("ul", { class: "setup-faults", role: "status" });
  #measures = h("ul", { class: "measures", "aria-label": "Pair geometry" });
  element = h(
    "section",
    { class: "card" },
    h("h2", {}, "Gear pair to scale"),
    this.#drawing.element,
    this.#faults,
    this.#measures,
  );

  /** Shows a geometry, or none, and errors. */
  show(geometry, refusals) {
    setChildren(
      this.#faults,
      refusals.map(({ detail }) => h("li", {}, detail)),
    );
    if (geometry) this.#drawing.show(geometry);
    else this.#drawing.showNotice("These values do not define drawable gears.");
    showMeasures(this.#measures, geometry?.measures ?? []);
  }

  /** Shows words instead. */
  showNotice(words) {
    this.#drawing.showNotice(words);
    setChildren(this.#measures);
    setChildren(this.#faults);
  }
}
