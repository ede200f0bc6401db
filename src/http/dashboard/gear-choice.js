// Selects the gear of a synchronous average: driving or driven. The address keeps it as `gear`.

import { h } from "./dom.js";
import { change } from "./route.js";

/** The number of the gear in an address: 1 driving, 2 driven. */
export const gearOf = (query) => (query.gear === "2" ? 2 : 1);

/** The selection of a gear beside the plot of its average. */
export class GearChoice {
  element = h(
    "select",
    {
      "aria-label": "Gear of the average",
      onchange: () => change({ gear: this.element.value }, { quiet: true }),
    },
    [
      ["", "Driving gear"],
      ["2", "Driven gear"],
    ].map(([value, text]) => h("option", { value }, text)),
  );

  /** Updates from the address; shows the tooth numbers when known. */
  show(query, teeth) {
    ["Driving gear", "Driven gear"].forEach((name, index) => {
      this.element.options[index].textContent = teeth ? `${name}, ${teeth[index]} teeth` : name;
    });
    this.element.value = gearOf(query) === 2 ? "2" : "";
  }
}
