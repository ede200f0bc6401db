// A list of a form, one row of fields per entry.

import { h, setChildren, setText } from "./dom.js";
import { brokenWords, valueAt } from "./field-values.js";

let made = 0; // rows, for the ids of their errors

/**
 * A list edited row by row; `columns` are `{ label, path?, value(entry), input?, place?, breaks? }`, and
 * `read(values)` builds an entry. `path` is that of the value in the entry, for errors.
 */
export class Rows {
  #columns;
  #read;
  #name;
  #list = h("div", { class: "setting-rows" });
  #error = h("p", { class: "field-error", hidden: true });
  element;

  constructor(name, columns, read, empty) {
    [this.#name, this.#columns, this.#read] = [name, columns, read];
    const add = h("button", { type: "button", onclick: () => this.#add(empty, true) }, `Add ${name}`);
    this.element = h("div", { class: "setting-list" }, this.#list, this.#error, add);
  }

  /** Replaces the displayed entries. */
  fill(entries) {
    setChildren(this.#list);
    for (const entry of entries) this.#add(entry, false);
  }

  #add(entry, focus) {
    const inputs = this.#columns.map(({ label, value, input }) => {
      const field = input?.() ?? h("input", { type: "number", step: "any" });
      field.value = value(entry) ?? "";
      field.setAttribute("aria-label", label);
      return field;
    });
    const row = h("div", { class: "setting-row" });
    const error = h("p", { class: "field-error row-error", id: `row-error-${++made}`, hidden: true });
    for (const field of inputs) field.setAttribute("aria-describedby", error.id);
    const remove = h(
      "button",
      {
        type: "button",
        class: "quiet",
        "aria-label": `Remove this ${this.#name}`,
        onclick: () => this.#remove(row),
      },
      "✕",
    );
    row.append(
      ...inputs.flatMap((field, n) => [
        this.#columns[n].breaks ? h("span", { class: "row-break" }) : "",
        h(
          "label",
          { class: `field ${this.#columns[n].place ?? ""}` },
          h("span", { "aria-hidden": "true" }, this.#columns[n].label),
          field,
        ),
      ]),
      remove,
      error,
    );
    Object.assign(row, { inputs, error });
    this.#list.append(row);
    if (focus) inputs[0].focus();
  }

  #remove(row) {
    row.remove();
    this.element.dispatchEvent(new Event("input", { bubbles: true }));
  }

  /** The entries as edited. */
  entries() {
    return [...this.#list.children].map(({ inputs }) => this.#read(inputs.map((field) => field.value)));
  }

  /**
   * Shows an error at the rows with the refused value, or below the list when no row has it; returns the first
   * input with the error.
   */
  fail(path, value, expected) {
    const column = this.#columns.findIndex((each) => path && each.path === path);
    const refused = parsed(value);
    const words = `expected ${expected}`;
    const rows = [...this.#list.children].filter(
      (row) =>
        column >= 0 &&
        JSON.stringify(valueAt(this.#read(row.inputs.map((field) => field.value)), path) ?? null) === refused,
    );
    for (const row of rows) this.#mark(row, column, words);
    this.#error.hidden = rows.length > 0;
    setText(this.#error, rows.length ? "" : `${this.#name[0].toUpperCase()}${this.#name.slice(1)}: ${words}`);
    return (
      rows[0]?.inputs[column] ??
      this.#list.querySelector("input, select") ??
      this.element.querySelector("button")
    );
  }

  /** Shows an error at number fields that contain something else; returns the first of them. */
  failBroken() {
    const broken = [...this.#list.children].flatMap((row) =>
      row.inputs.flatMap((input, column) => (brokenWords(input) ? [{ row, input, column }] : [])),
    );
    for (const { row, input, column } of broken) this.#mark(row, column, `expected ${brokenWords(input)}`);
    return broken[0]?.input;
  }

  #mark({ inputs, error }, column, words) {
    inputs[column].setAttribute("aria-invalid", "true");
    error.hidden = false;
    setText(error, `${this.#columns[column].label}: ${words}`);
  }

  clearErrors() {
    this.#error.hidden = true;
    for (const { inputs, error } of this.#list.children) {
      error.hidden = true;
      for (const field of inputs) field.removeAttribute("aria-invalid");
    }
  }
}

/** A refused value, which errors have as JSON or as text, as JSON. */
function parsed(value) {
  try {
    return JSON.stringify(JSON.parse(value));
  } catch {
    return JSON.stringify(value ?? null);
  }
}
