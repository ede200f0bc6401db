// Whose turn an average is over: the driving or the driven gear's. The address keeps it as `gear`.

import { h } from "./dom.js";
import { change } from "./route.js";

/** The number of the gear that an address asks for: 1 the driving one, 2 the driven one. */
export const gearOf = (query) => (query.gear === "2" ? 2 : 1);

/** The choice of a gear beside a plot of its average. */
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

  /** Follows the address; the gears are named with their teeth where these are known. */
  show(query, teeth) {
    ["Driving gear", "Driven gear"].forEach((name, index) => {
      this.element.options[index].textContent = teeth ? `${name}, ${teeth[index]} teeth` : name;
    });
    this.element.value = gearOf(query) === 2 ? "2" : "";
  }
}
