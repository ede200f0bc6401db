// Selects the gear of a synchronous average: driving, driven, or both. The address keeps it as `gear`.

import { h } from "./dom.js";
import { change } from "./route.js";

/**
 * The numbers of the gears in an address: 1 driving, 2 driven.
 * @returns {(1 | 2)[]}
 */
export const gearsIn = ({ gear }) => (gear === "both" ? [1, 2] : gear === "2" ? [2] : [1]);

const NAMES = ["Driving gear", "Driven gear"];

/** The selection of a gear beside the plot of its average. */
export class GearChoice {
  element = h(
    "select",
    {
      "aria-label": "Gear of the average",
      onchange: () => change({ gear: this.element.value }, { quiet: true }),
    },
    [
      ["", NAMES[0]],
      ["2", NAMES[1]],
      ["both", "Both gears"],
    ].map(([value, text]) => h("option", { value }, text)),
  );

  /** Updates from the address; shows the tooth counts when known. A machine without gears has no choice. */
  show(query, teeth, hasGears = true) {
    this.element.hidden = !hasGears;
    NAMES.forEach((name, index) => {
      this.element.options[index].textContent = teeth ? `${name}, ${teeth[index]} teeth` : name;
    });
    const [gear, other] = gearsIn(query);
    this.element.value = other ? "both" : gear === 2 ? "2" : "";
  }
}
