// The inputs of the asset form: converts between inputs and description, and shows errors at the fields.

import { h, setText } from "./dom.js";
import { UNITS, unknownUnitWords } from "./known-units.js";
import { beyondWords, boundWords, brokenWords, outsideRange, putAt, tidy, valueAt } from "./field-values.js";

const TYPES = { text: "text", id: "text", check: "checkbox", off: "checkbox", date: "date" };

/** The path of a list's entry. */
const LISTED = /^(points|bearings|bands|gear\.other_meshes)\.\d+/;

/** One field with label, input and error message. */
class FieldInput {
  field;
  input;
  element;
  #error;
  #warning;
  #label;
  #about;
  /** The value of an empty field, sent when the other gear has one; undefined without one. */
  derived;

  constructor(field) {
    this.field = field;
    const { path, label, unit, kind = "number", hint, about } = field;
    const id = `setup-${path.replaceAll(/[._]/g, "-")}`;
    this.#error = h("span", { class: "field-error", id: `${id}-error`, hidden: true });
    this.#warning = h("span", { class: "field-warning", id: `${id}-warning`, role: "status", hidden: true });
    this.#label = label;
    this.#about =
      (about || field.derivedFrom) &&
      h("span", { class: "muted field-about", id: `${id}-about` }, about ?? `Default: ${field.derivedFrom}.`);
    if (kind === "choice")
      this.input = h(
        "select",
        { id },
        field.choices.map(([value, words]) => h("option", { value }, words)),
      );
    else
      this.input = h("input", {
        id,
        type: TYPES[kind] ?? "number",
        step: kind === "integer" ? "1" : "any",
        placeholder: hint,
        autocomplete: "off",
        spellcheck: "false",
        required: field.needed,
        list: field.isUnit ? UNITS : null,
      });
    const described = [`${id}-error`, `${id}-warning`, this.#about && `${id}-about`];
    this.input.setAttribute("aria-describedby", described.filter(Boolean).join(" "));
    const words = unit ? `${label} (${unit})` : label;
    if (kind === "check" || kind === "off")
      this.element = h(
        "div",
        { class: "setup-field" },
        h("label", { class: "check", for: id }, this.input, words),
        this.#about,
        this.#warning,
        this.#error,
      );
    else
      this.element = h(
        "div",
        { class: "setup-field" },
        h("label", { class: "field", for: id }, h("span", {}, words), this.input),
        this.#about,
        this.#warning,
        this.#error,
      );
  }

  /** The entered value; undefined when empty. */
  get value() {
    const { kind = "number", factor = 1 } = this.field;
    if (kind === "check") return this.input.checked || undefined;
    if (kind === "off") return this.input.checked ? false : undefined;
    const text = this.input.value.trim();
    if (text === "") return undefined;
    return kind === "number" || kind === "integer" ? tidy(Number(text) * factor) : text;
  }

  set value(value) {
    const { kind = "number", factor = 1 } = this.field;
    if (kind === "check") this.input.checked = Boolean(value);
    else if (kind === "off") this.input.checked = value === false;
    else
      this.input.value =
        value === undefined || value === null
          ? ""
          : typeof value === "number"
            ? String(tidy(value / factor))
            : value;
  }

  /** Sets and shows the value of the empty field. */
  derive(value) {
    this.derived = value;
    const { hint, derivedFrom } = this.field;
    this.input.placeholder = value ?? hint ?? "";
    setText(
      this.#about,
      value === undefined
        ? `Default: ${derivedFrom}.`
        : `Default: ${derivedFrom}, ${value} ${this.field.unit}.`,
    );
  }

  /** What a number field should contain in place of its text; null if it is good. */
  get broken() {
    return brokenWords(this.input);
  }

  /** Shows a note about a value that is accepted nevertheless; hides it when `words` is empty. */
  warn(words) {
    this.#warning.hidden = !words;
    setText(this.#warning, words);
  }

  /** Shows an error with the field's label; hides it when `words` is empty. */
  fail(words) {
    this.#error.hidden = !words;
    setText(this.#error, words ? `${this.#label}: ${words}` : "");
    if (words) this.input.setAttribute("aria-invalid", "true");
    else this.input.removeAttribute("aria-invalid");
  }

  get isFailed() {
    return this.input.hasAttribute("aria-invalid");
  }
}

/**
 * Whether a field applies: `mesh` says whether the machine has gears, `pair` whether their pair is described.
 */
function belongs({ path, ofPair }, { mesh, pair }) {
  if (path.startsWith("shaft.")) return !mesh;
  if (path.startsWith("gear.") || path.startsWith("limits.")) return mesh && (pair || !ofPair);
  return true;
}

/** All inputs of a form. */
export class SetupInputs {
  #inputs = new Map();

  /** The element of a field. */
  make(field) {
    const made = new FieldInput(field);
    this.#inputs.set(field.path, made);
    return made.element;
  }

  get(path) {
    return this.#inputs.get(path);
  }

  /** Forgets a field that was removed from the form. */
  drop(path) {
    this.#inputs.delete(path);
  }

  /** Fills the fields from a description; returns what no field covers, or null. */
  fill(description) {
    const rest = structuredClone(description);
    for (const [path, made] of this.#inputs) {
      made.value = valueAt(rest, path);
      putAt(rest, path, undefined);
      if (made.field.alike && valueAt(rest, made.field.alike) !== undefined)
        putAt(rest, made.field.alike, undefined);
      made.fail("");
    }
    return pruned(rest);
  }

  /** Shows the fields that apply and hides the others; warns about values far from the usual ones. */
  show(shape, most) {
    for (const { field, element } of this.#inputs.values()) element.hidden = !belongs(field, shape);
    this.warn(most);
  }

  /** Warns about unknown units and about limits above `most`, the greatest wear that can be estimated. */
  warn(most) {
    for (const made of this.#inputs.values()) {
      const { field, value } = made;
      if (field.isUnit) made.warn(unknownUnitWords(value));
      else if (field.path.startsWith("limits.")) made.warn(beyondWords(value, most));
    }
  }

  /** The description from the fields, merged over what no field covers. */
  description(rest, shape) {
    const spec = structuredClone(rest ?? {});
    if (!shape.pair && spec.gear) delete spec.gear.pair;
    if (shape.mesh) delete spec.shaft;
    else {
      delete spec.gear;
      spec.shaft ??= {};
    }
    for (const { field, value } of this.#inputs.values()) {
      if (value === undefined || !belongs(field, shape)) continue;
      putAt(spec, field.path, value);
      if (field.alike && shape.pair) putAt(spec, field.alike, value);
    }
    this.#completeLists(spec, shape);
    this.#derive(spec, shape);
    return spec;
  }

  /** Shows what empty fields default to; when only one of two gears has a value, the other one's is added. */
  #derive(spec, shape) {
    for (const made of this.#inputs.values()) {
      const { path, derived } = made.field;
      if (!derived || !belongs(made.field, shape)) continue;
      const value = derived(spec);
      made.derive(value);
      if (value !== undefined && valueAt(spec, path) === undefined && valueAt(spec, path.slice(0, -2)))
        putAt(spec, path, value);
    }
  }

  /** When only one of two gears has a value, the other one's default is added. */
  #completeLists(spec, shape) {
    for (const { field } of this.#inputs.values()) {
      if (
        field.pairDefault === undefined ||
        !belongs(field, shape) ||
        valueAt(spec, field.path) !== undefined
      )
        continue;
      if (valueAt(spec, field.path.slice(0, -2))) putAt(spec, field.path, field.pairDefault);
    }
  }

  /** Required fields that are empty. */
  lacking(shape) {
    return [...this.#inputs.values()]
      .filter(
        ({ field, value, broken }) => field.needed && belongs(field, shape) && value === undefined && !broken,
      )
      .map(({ field }) => field);
  }

  /** Whether a number field, of those below a path, contains something else. */
  isBroken(shape, path = "") {
    return [...this.#inputs.values()].some(
      ({ field, broken }) => broken && field.path.startsWith(path) && belongs(field, shape),
    );
  }

  /** Errors for empty fields that must be set together with others. */
  incomplete(shape) {
    const own = [...this.#inputs.values()].filter(
      ({ field }) => field.together && field.pairDefault === undefined && belongs(field, shape),
    );
    const given = new Set(own.filter(({ value }) => value !== undefined).map(({ field }) => field.together));
    return own
      .filter(({ field, value }) => value === undefined && given.has(field.together))
      .map(({ field: { path } }) => ({ field: path, expected: "a value, as the related fields have one" }));
  }

  /** Clears all errors except those of number fields without a number. */
  clearErrors() {
    for (const made of this.#inputs.values()) made.fail(made.broken ? `expected ${made.broken}` : "");
  }

  /** Shows an error at its field; returns false when there is no such field. */
  fail({ field: name, value, expected }) {
    if (!name) return false;
    let own = [...this.#inputs.values()].filter(({ field }) =>
      [field.path, field.alike].some(
        (path) =>
          path &&
          (path === name ||
            path.startsWith(`${name}.`) ||
            path.endsWith(`.${name}`) ||
            `${path}.`.replace(LISTED, "$1").startsWith(`${name}.`)),
      ),
    );
    if (own.length === 0) return false;
    const entries = this.#entriesWith(own, String(value));
    if (entries.length) own = entries;
    // For two gears' values, the field with the refused value
    const typed = own.filter((made) =>
      [String(valueOf(made)), JSON.stringify(valueOf(made))].includes(String(value)),
    );
    const gear = /\bgear ([12])\b/.exec(expected ?? "")?.[1];
    const meant =
      typed.length === 1
        ? typed
        : own.length === 2 && gear && !typed.length
          ? [own[Number(gear) - 1]]
          : typed.length
            ? typed
            : outsideRange(own, expected, valueOf);
    for (const made of meant)
      if (!made.isFailed) made.fail(expected ? `expected ${boundWords(expected, made.field)}` : "required");
    return true;
  }

  /** Of the fields of a list, those of the entry that an error quotes: `name = "low", …` or `teeth = [19, 57], …`. */
  #entriesWith(own, quoted) {
    const at = (path) => this.#inputs.get(path)?.value;
    return own.filter(({ field }) => {
      const entry = LISTED.exec(field.path)?.[0];
      const words = [
        `name = ${JSON.stringify(at(`${entry}.name`))}`,
        `teeth = [${at(`${entry}.teeth.0`)}, ${at(`${entry}.teeth.1`)}]`,
      ];
      return entry && words.some((text) => quoted.includes(text));
    });
  }

  /** Moves the focus to the first error. */
  focusError() {
    const first = [...this.#inputs.values()].find((made) => made.isFailed);
    const folded = first?.input.closest("details");
    if (folded) folded.open = true;
    first?.input.focus();
  }
}

function valueOf({ value, field, derived }) {
  return value ?? field.pairDefault ?? derived;
}

/** An object without empty values; null when nothing is left. */
function pruned(value) {
  if (value === null || value === undefined) return null;
  if (Array.isArray(value)) return value.some((each) => pruned(each) !== null) ? value : null;
  if (typeof value !== "object") return value;
  const kept = Object.entries(value)
    .map(([key, inner]) => [key, pruned(inner)])
    .filter(([, inner]) => inner !== null);
  return kept.length ? Object.fromEntries(kept) : null;
}
