// The part of a description that has no field of its own, as JSON.

import { h, setText } from "./dom.js";

/** A folded text area with the JSON of an object. */
export class JsonPart {
  #input = h("textarea", {
    id: "setup-json",
    rows: "7",
    spellcheck: "false",
    "aria-describedby": "setup-json-error",
  });
  #error = h("span", { class: "field-error", id: "setup-json-error", hidden: true });
  element;

  constructor() {
    const words =
      "Anything without a field above, as API JSON, such as a measured wear profile. Fields above take precedence.";
    this.element = h(
      "details",
      { class: "card setup-more" },
      h("summary", {}, "All other fields as JSON"),
      h("label", { class: "field", for: "setup-json" }, h("span", {}, words), this.#input),
      this.#error,
    );
  }

  /** The entered object; null when the text is invalid. */
  read() {
    const text = this.#input.value.trim();
    let words = "";
    let rest = {};
    try {
      rest = text ? JSON.parse(text) : {};
      if (typeof rest !== "object" || Array.isArray(rest) || rest === null)
        words = "expected an object in braces";
    } catch (error) {
      words = error.message;
    }
    this.#error.hidden = !words;
    setText(this.#error, words && `Other fields as JSON: ${words}`);
    this.#input.toggleAttribute("aria-invalid", false);
    if (words) this.#input.setAttribute("aria-invalid", "true");
    return words ? null : rest;
  }

  /** Shows an object, folded; null for none. */
  write(part) {
    this.#input.value = part ? JSON.stringify(part, null, 2) : "";
    this.element.open = false;
  }
}
