// An asset's settings as a form, with a live drawing of its gear pair.

import * as api from "./api.js";
import { FramedPage, INVALID, savingWords } from "./asset-frame.js";
import { h, setChildren, setText } from "./dom.js";
import {
  beyondWords,
  boundWords,
  brokenWords,
  outsideRange,
  putAt,
  reachWords,
  tidy,
  valueAt,
} from "./field-values.js";
import { assetName } from "./fleet-row.js";
import { drawPair } from "./gear-drawing.js";
import { followLimits, SettingLists } from "./settings-lists.js";
import { UNITS, unitList, unknownUnitWords } from "./known-units.js";
import { GROUPS } from "./settings-fields.js";
import { removalCard } from "./settings-removal.js";

/** The settings of one asset. */
export class SettingsPage extends FramedPage {
  holdsEntries = true;
  #asset;
  #inputs = new Map();
  #lists = new SettingLists();
  #drawing = h("div", { class: "gear-drawing" });
  #pair = h("section", { class: "card" }, h("h2", {}, "Gear pair to scale"), this.#drawing);
  #reach = h("p", { class: "muted", hidden: true }); // below the limits
  #most; // µm of wear that can be estimated
  #result = h("p", { class: "result", role: "status" });
  #save = h("button", { type: "submit", class: "primary" }, "Save");
  #undo = h("button", { type: "button", onclick: () => this.#fill() }, "Undo changes");
  #form;
  #filled; // the description as JSON, before any edit

  constructor(root, route) {
    super(root, route, "settings");
    setChildren(root, this.head.element, h("p", { class: "notice" }, "Loading settings…"));
  }

  update(route) {
    this.query = route.query;
    return false;
  }

  /** Fetches once, so that edits are not overwritten. */
  async refresh(signal) {
    if (this.#asset) return;
    const asset = await this.loadAsset(signal);
    if (!asset) return;
    this.#asset = asset;
    this.#build();
    this.#fill();
    await this.#showReach();
  }

  #build() {
    const { gear } = this.#asset;
    const isThere = ({ pair, mesh, shaft }) => (!pair || gear?.pair) && (!mesh || gear) && (!shaft || !gear);
    const groups = GROUPS.filter(isThere).map((group) =>
      h(
        "fieldset",
        { class: "card" },
        h("legend", {}, group.title),
        h(
          "div",
          { class: "form-fields" },
          group.fields.map((field) => this.#field(field)),
        ),
        group.title === "Limits on wear depth" && this.#reach,
      ),
    );
    const note =
      !gear || gear.pair
        ? null
        : h(
            "p",
            { class: "notice" },
            "This asset has no gear pair, so wear in µm is not estimated. ",
            h("a", { href: `#/new?edit=${encodeURIComponent(this.id)}` }, "Add its gears"),
          );
    const buttons = h(
      "div",
      { class: "form-buttons" },
      this.#save,
      this.#undo,
      h("span", { class: "muted" }, "Changing the gear pair or the baseline recomputes the whole history."),
    );
    this.#form = h(
      "form",
      {
        class: "settings",
        novalidate: true,
        onsubmit: (event) => this.#submit(event),
        oninput: () => this.#typed(),
      },
      groups,
      this.#lists.elements,
      unitList(),
      note,
      this.#result,
      buttons,
    );
    setChildren(
      this.root,
      this.head.element,
      h(
        "div",
        { class: "settings-grid" },
        this.#form,
        h("div", { class: "column" }, this.#asset.gear?.pair ? this.#pair : null, removalCard(this.id)),
      ),
    );
  }

  #field(field) {
    const { path, label, unit, kind = "number", hint, about, isUnit } = field;
    const id = `setting-${path.replaceAll(".", "-")}`;
    const type = { text: "text", check: "checkbox" }[kind] ?? "number";
    const input = h("input", {
      id,
      type,
      step: kind === "integer" ? "1" : "any",
      placeholder: hint,
      autocomplete: "off",
      list: isUnit ? UNITS : null,
    });
    const error = h("span", { class: "field-error", id: `${id}-error`, hidden: true });
    const warning = h("span", { class: "field-warning", id: `${id}-warning`, role: "status", hidden: true });
    const note = about ? h("span", { class: "muted field-about", id: `${id}-about` }, about) : null;
    const described = [error, warning, note].filter(Boolean).map((element) => element.id);
    input.setAttribute("aria-describedby", described.join(" "));
    this.#inputs.set(path, { field, input, error, warning });
    const words = unit ? `${label} (${unit})` : label;
    const labelled =
      kind === "check"
        ? h("label", { class: "check", for: id }, input, words)
        : h("label", { class: "field", for: id }, h("span", {}, words), input);
    return h("div", { class: "setup-field" }, labelled, note, warning, error);
  }

  /** Warns about an unknown unit, and about limits above the greatest wear that can be estimated. */
  #warn() {
    for (const { field, input, warning } of this.#inputs.values()) {
      const words = field.isUnit
        ? unknownUnitWords(input.value.trim())
        : field.path.startsWith("limits.")
          ? beyondWords(Number(input.value), this.#most)
          : "";
      warning.hidden = !words;
      setText(warning, words);
    }
  }

  /** Shows how deep wear can be estimated with the asset's library, if it is complete. */
  async #showReach() {
    const { library_id: id, library_state: state } = this.#asset.summary;
    const library = state === "ready" ? await api.settle(api.library(id)) : null;
    this.#most = library && !(library instanceof Error) ? library.max_wear_um : undefined;
    this.#reach.hidden = !this.#most;
    setText(this.#reach, reachWords(this.#most));
    this.#warn();
  }

  #fill() {
    for (const [path, { field, input }] of this.#inputs) {
      const value = valueAt(this.#asset, path);
      if (field.kind === "check") input.checked = Boolean(value);
      else input.value = typeof value === "number" ? tidy(value / (field.factor ?? 1)) : (value ?? "");
    }
    this.#clearErrors();
    this.#lists.fill(this.#asset);
    setText(this.#result, "");
    this.#result.dataset.kind = "";
    this.#typed();
    this.#filled = JSON.stringify(this.#description());
  }

  /** Whether leaving the page loses edits. */
  get hasUnsaved() {
    return Boolean(this.#filled) && JSON.stringify(this.#description()) !== this.#filled;
  }

  /** The description from the form; the service ignores what it adds to its answers. */
  #description() {
    const spec = structuredClone(this.#asset);
    for (const [path, { field, input }] of this.#inputs) {
      const { kind = "number", alike, factor = 1 } = field;
      const text = input.value.trim();
      const entered = () => (kind === "text" ? text : tidy(Number(text) * factor));
      const value = kind === "check" ? input.checked : text === "" ? undefined : entered();
      if (value === undefined && valueAt(spec, path) === undefined) continue;
      putAt(spec, path, value);
      if (alike && spec.gear?.pair) putAt(spec, alike, value);
    }
    this.#lists.put(spec);
    return spec;
  }

  #typed() {
    this.#warn();
    const spec = this.#description();
    if (spec.gear?.pair) drawPair(this.#drawing, spec.gear.pair.geometry);
  }

  async #submit(event) {
    event.preventDefault();
    this.#clearErrors();
    const broken = this.#failBroken();
    if (broken) return this.#invalid(broken);
    this.#save.disabled = true;
    try {
      const description = this.#description();
      followLimits(description, this.#asset);
      this.#asset = await api.replaceAsset(this.id, description, this.#asset);
      this.#fill();
      await this.#showReach();
      this.head.update(assetName(this.#asset), this.query, this.#asset);
      this.#showNotice("good", "Saved.");
    } catch (error) {
      this.#refuse(error);
    } finally {
      this.#save.disabled = false;
    }
  }

  #clearErrors() {
    for (const { input, error } of this.#inputs.values()) {
      input.removeAttribute("aria-invalid");
      error.hidden = true;
    }
    this.#lists.clearErrors();
  }

  /** Shows an error at its fields, in the words of their labels. */
  #refuse(error) {
    const { field: name, expected } = error.problem ?? {};
    const own = [...this.#inputs.values()].filter(
      ({ field: { path } }) =>
        name &&
        (path === name ||
          path.endsWith(`.${name}`) ||
          path.startsWith(`${name}.`) ||
          path.startsWith(`gear.pair.${name}`)),
    );
    const meant = outsideRange(own, expected, ({ input }) => Number(input.value));
    for (const made of meant) this.#mark(made, expected);
    const first = meant[0]?.input ?? (name ? this.#lists.fail(error.problem) : null);
    if (first) return this.#invalid(first);
    this.#showNotice("bad", savingWords(error));
  }

  /** Shows an error at number fields that contain something else; returns the first of them. */
  #failBroken() {
    const broken = [...this.#inputs.values()].filter(({ input }) => brokenWords(input));
    for (const made of broken) this.#mark(made, brokenWords(made.input));
    const listed = this.#lists.failBroken();
    return broken[0]?.input ?? listed;
  }

  #mark({ field, input, error }, expected) {
    input.setAttribute("aria-invalid", "true");
    error.hidden = false;
    setText(error, `${field.label}: expected ${boundWords(expected, field)}`);
  }

  #invalid(input) {
    input.focus();
    this.#showNotice("bad", INVALID);
  }

  #showNotice(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }
}
