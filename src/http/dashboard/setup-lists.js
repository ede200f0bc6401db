// Further entries of the lists of a description: measuring points, bearings, bands, other meshes. The first
// of each has its fields in the form; every further one has them in a box of its own.

import { h } from "./dom.js";
import { SETUP_FIELDS } from "./setup-fields.js";
import { valueAt } from "./field-values.js";

const LISTS = [
  { path: "bearings", word: "bearing", group: "Bearing and velocity" },
  { path: "points", word: "measuring point", group: "Sensor" },
  { path: "bands", word: "custom band", group: "Sensor" },
  { path: "gear.other_meshes", word: "mesh on the machine", group: "Sensor" },
];

/** The paths of all lists. */
export const LIST_PATHS = LISTS.map(({ path }) => path);

/** One list; `onChange` is called when an entry is added or removed. */
class SetupList {
  path;
  #word;
  #inputs;
  #onChange;
  #fields;
  #rows = h("div", { class: "setup-entries" });
  element;

  constructor({ path, word }, inputs, onChange) {
    [this.path, this.#word, this.#inputs, this.#onChange] = [path, word, inputs, onChange];
    this.#fields = SETUP_FIELDS.filter((field) => field.path.startsWith(`${path}.0.`));
    const add = h(
      "button",
      { type: "button", class: "quiet", onclick: () => this.#add() },
      `Add another ${word}`,
    );
    this.element = h("div", { class: "setup-list" }, this.#rows, add);
  }

  get count() {
    return 1 + this.#rows.children.length;
  }

  /** Sets the number of entries, at least one. */
  resize(count) {
    while (this.count < count) this.#append();
    while (this.count > Math.max(1, count)) this.#drop();
  }

  /** The fields of an entry, with its number from the second on. */
  #fieldsOf(index) {
    const moved = (text) => text?.replace(`${this.path}.0`, `${this.path}.${index}`);
    return this.#fields.map((field) => ({
      ...field,
      path: moved(field.path),
      together: moved(field.together),
      label: `${field.label} ${index + 1}`,
    }));
  }

  #append() {
    const index = this.count;
    const name = `${this.#word[0].toUpperCase()}${this.#word.slice(1)} ${index + 1}`;
    const remove = h(
      "button",
      {
        type: "button",
        class: "quiet",
        "aria-label": `Remove ${this.#word} ${index + 1}`,
        onclick: () => this.#remove(index),
      },
      "✕",
    );
    this.#rows.append(
      h(
        "div",
        { class: "setup-entry", role: "group", "aria-label": `Fields of ${this.#word} ${index + 1}` },
        h("div", { class: "plot-head" }, h("strong", {}, name), remove),
        h(
          "div",
          { class: "form-fields" },
          this.#fieldsOf(index).map((field) => this.#inputs.make(field)),
        ),
      ),
    );
  }

  #drop() {
    for (const { path } of this.#fieldsOf(this.count - 1)) this.#inputs.drop(path);
    this.#rows.lastElementChild.remove();
  }

  #add() {
    this.#append();
    this.#rows.lastElementChild.querySelector("input, select").focus();
    this.#onChange();
  }

  /** Removes an entry; the later ones move up. */
  #remove(index) {
    for (let n = index; n < this.count - 1; n++) {
      const [own, next] = [this.#fieldsOf(n), this.#fieldsOf(n + 1)];
      own.forEach(({ path }, k) => (this.#inputs.get(path).value = this.#inputs.get(next[k].path).value));
    }
    this.#drop();
    this.#onChange();
  }
}

/** All lists of the form. */
export class SetupLists {
  #lists;

  constructor(inputs, onChange) {
    this.#lists = LISTS.map((list) => ({ ...list, list: new SetupList(list, inputs, onChange) }));
  }

  /** The elements in a group of the form. */
  of(title) {
    return this.#lists.filter(({ group }) => group === title).map(({ list }) => list.element);
  }

  /** Makes fields for all entries of a description. */
  resize(description) {
    for (const { path, list } of this.#lists) list.resize(valueAt(description, path)?.length ?? 1);
  }

  /** Hides the lists that do not apply to a machine without gears. */
  show({ mesh }) {
    for (const { path, list } of this.#lists) list.element.hidden = path.startsWith("gear.") && !mesh;
  }
}

/** Removes the entries without any value from the lists of a description. */
export function withoutGaps(spec) {
  for (const path of LIST_PATHS) {
    const list = valueAt(spec, path);
    if (!Array.isArray(list)) continue;
    const kept = list.filter((entry) => entry && Object.keys(entry).length);
    list.splice(0, list.length, ...kept);
  }
  return spec;
}
