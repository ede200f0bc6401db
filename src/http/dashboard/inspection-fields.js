// The fields of an inspection in the dialog for maintenance, each with what is wrong with it beside it.

import { h, setText } from "./dom.js";
import { GEARS, PLACES } from "./inspection.js";

const USUAL_ERROR_UM = 5;

/** A field for a number that says below itself what it expects where it has something else. */
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
    const good = expected.holds(input.valueAsNumber); // not a number where it is empty
    if (good) input.removeAttribute("aria-invalid");
    else input.setAttribute("aria-invalid", "true");
    setText(fault, good ? "" : `Expected ${expected.words}.`);
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

/** Depth, error, gear and place of a measurement. */
export class InspectionFields {
  #depth = numberField(
    "inspection-depth",
    "Measured depth (µm)",
    "1 µm is a thousandth of a millimetre",
    undefined,
    { words: "a depth from 0 to 100000 µm", holds: (value) => value >= 0 && value <= 1e5 },
  );
  #error = numberField(
    "inspection-error",
    "Its standard error (µm)",
    "two of three measurements are off by less",
    USUAL_ERROR_UM,
    { words: "a number above 0 and up to 10000 µm", holds: (value) => value > 0 && value <= 1e4 },
  );
  #gear = choice("inspection-gear", "On which gear", GEARS);
  #place = choice("inspection-place", "Where on the flank", PLACES);
  element = h(
    "fieldset",
    { class: "inspection", hidden: true, disabled: true },
    h("legend", {}, "What was measured"),
    h(
      "div",
      { class: "fields" },
      this.#depth.element,
      this.#error.element,
      this.#gear.element,
      this.#place.element,
    ),
  );

  /** Shows the fields or not. */
  show(is) {
    this.element.hidden = !is;
    this.element.disabled = !is; // nothing in it then keeps the form from being sent
  }

  /** What the fields say, or null where one is wrong, which then says so. */
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

  /** Forgets the depth, which is of one measurement; its error and place are likely those of the next. */
  clear() {
    this.#depth.input.value = "";
  }
}
