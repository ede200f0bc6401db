// The inspection fields of the maintenance dialog, each with its error message.

import { h, setText } from "./dom.js";
import { GEARS, PLACES } from "./inspection.js";

const USUAL_ERROR_UM = 5;

/** A number field that shows an error message below it. */
function numberField(id, label, hint, value, expected) {
  const fault = h("span", { id: `${id}-fault`, class: "field-fault", role: "alert" });
  const words = h("span", { id: `${id}-hint`, class: "muted" }, hint);
  const input = h("input", {
    id,
    type: "number",
    step: "any",
    inputmode: "decimal",
    value,
    "aria-required": "true",
    "aria-describedby": `${id}-hint ${id}-fault`,
  });
  const judge = () => {
    const good = expected.holds(input.valueAsNumber); // NaN when empty
    if (good) input.removeAttribute("aria-invalid");
    else input.setAttribute("aria-invalid", "true");
    setText(fault, good ? "" : `Enter ${expected.words}.`);
    return good;
  };
  input.addEventListener("input", () => fault.textContent && judge());
  input.addEventListener("change", judge);
  return {
    input,
    judge,
    element: h("div", { class: "field" }, h("label", { for: id }, label), input, words, fault),
  };
}

function choice(id, label, options) {
  const select = h(
    "select",
    { id },
    Object.entries(options).map(([value, words]) =>
      h("option", { value, selected: value === "" || value === "greatest" }, words),
    ),
  );
  return { select, element: h("div", { class: "field" }, h("label", { for: id }, label), select) };
}

/** Depth, standard error, gear and place of a measurement. */
export class InspectionFields {
  #depth = numberField("inspection-depth", "Measured depth (µm)", "1 µm = 0.001 mm", undefined, {
    words: "a depth from 0 to 100000 µm",
    holds: (value) => value >= 0 && value <= 1e5,
  });
  #error = numberField(
    "inspection-error",
    "Standard error (µm)",
    "about two thirds of measurements deviate by less",
    USUAL_ERROR_UM,
    { words: "a number above 0 and up to 10000 µm", holds: (value) => value > 0 && value <= 1e4 },
  );
  #gear = choice("inspection-gear", "Measured gear", GEARS);
  #place = choice("inspection-place", "Place on the flank", PLACES);
  element = h(
    "fieldset",
    { class: "inspection", hidden: true, disabled: true },
    h("legend", {}, "Measurement"),
    h(
      "div",
      { class: "fields" },
      this.#depth.element,
      this.#error.element,
      this.#gear.element,
      this.#place.element,
    ),
  );

  /** Shows or hides the fields. */
  show(is) {
    this.element.hidden = !is;
    this.element.disabled = !is; // so that hidden fields do not block submission
  }

  /** The measurement, or null when a field is invalid, which then shows its error. */
  value() {
    const numbers = [this.#depth, this.#error];
    const wrong = numbers.filter((field) => !field.judge());
    if (wrong.length) {
      wrong[0].input.focus();
      return null;
    }
    const [depth, error] = numbers.map(({ input }) => input.valueAsNumber);
    const gear = this.#gear.select.value;
    return {
      depth_um: depth,
      error_um: error,
      ...(gear ? { gear: Number(gear) } : {}),
      place: this.#place.select.value,
    };
  }

  /** Clears the depth; error and place are likely the same next time. */
  clear() {
    this.#depth.input.value = "";
  }
}
