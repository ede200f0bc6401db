// The form for a new, copied or existing asset, with a live drawing and preview of its gear pair.

import * as api from "./api.js";
import { crumbs } from "./asset-frame.js";
import { h, setChildren, setText } from "./dom.js";
import { PairDrawing } from "./preview-drawing.js";
import { PreviewPanel } from "./preview-panel.js";
import { format, go } from "./route.js";
import { SETUP_GROUPS } from "./setup-fields.js";
import { SetupInputs } from "./setup-inputs.js";
import { SetupDraft } from "./setup-draft.js";
import { SetupLists, withoutGaps } from "./setup-lists.js";
import { showMeasures } from "./setup-measures.js";
import { SettingLists } from "./settings-lists.js";

const TYPED_MS = 250; // ms without typing before a preview is requested
const FROM_SERVER = ["summary", "created_at", "updated_at"];
const NUMBERS = "numbers";
const NONE = "none";
const NO_GEARS = "no-gears";

/** The fields without which an asset cannot be created; those of the pair can be done without. */
function requiredWords(lacking) {
  const words = `Still required: ${lacking.map(({ label }) => `“${label}”`).join(", ")}.`;
  return lacking.every(({ ofPair }) => ofPair)
    ? `${words} Without them, choose “None: indicators only” as the gear pair: everything but the wear in µm is computed.`
    : words;
}

/** Derives an id from a name. */
const slug = (name) =>
  name
    .toLowerCase()
    .normalize("NFKD")
    .replaceAll(/[^a-z0-9_]+/g, "-")
    .replaceAll(/^[-_]+|-+$/g, "")
    .slice(0, 64);

/** Errors that the page can detect by itself. */
function typedRefusals({ id, limits, points, velocity_zones: zones }) {
  const refusals = [];
  if (id && !/^[a-z0-9][a-z0-9_-]{0,63}$/.test(id))
    refusals.push({
      field: "id",
      value: id,
      expected: "1 to 64 characters of a–z, 0–9, - and _, the first a letter or digit",
    });
  if (limits?.warning_um > limits?.danger_um)
    refusals.push({
      field: "limits.warning_um",
      value: limits.warning_um,
      expected: "a depth at or below the danger limit",
    });
  if (zones?.machine_class && zones.limits_mm_per_s)
    refusals.push({
      field: "velocity_zones.limits_mm_per_s",
      expected: "no custom limits together with a machine class",
    });
  for (const [n, point] of (points ?? []).entries())
    if (!point?.channel)
      refusals.push({ field: `points.${n}.channel`, expected: "a name, as its sensor has data" });
  return refusals;
}

/** The page at `#/new`; `copy` or `edit` in its address names an asset. */
export class SetupPage {
  #query;
  #inputs = new SetupInputs();
  #lists = new SetupLists(this.#inputs, () => this.#check(TYPED_MS));
  #rules = new SettingLists();
  #presets = [];
  #asked = false;
  #idTyped = false;
  /** Errors by source: the page, the latest preview, the latest attempt to save. */
  #refusals = { typed: [], previewed: [], saved: [] };
  #title = h("h1", {}, "New asset");
  #pair = h("select", { id: "setup-pair", onchange: () => this.#choosePair() });
  #json = h("textarea", {
    id: "setup-json",
    rows: "7",
    spellcheck: "false",
    "aria-describedby": "setup-json-error",
  });
  #jsonError = h("span", { class: "field-error", id: "setup-json-error", hidden: true });
  #result = h("p", { class: "result", role: "status" });
  #save = h("button", { type: "submit", class: "primary" }, "Create asset");
  #drawing = new PairDrawing();
  #measures = h("ul", { class: "measures", "aria-label": "Pair geometry" });
  #faults = h("ul", { class: "setup-faults", role: "status" });
  #panel = new PreviewPanel({
    onPreview: (preview) => this.#previewed(preview),
    onError: (error) => this.#refused(error),
  });
  #form;
  #draft;

  constructor(root, route) {
    this.#query = route.query;
    this.#form = h(
      "form",
      {
        class: "settings setup-form",
        novalidate: true,
        onsubmit: (event) => this.#submit(event),
        oninput: (event) => this.#typed(event),
      },
      SETUP_GROUPS.map((group) => this.#group(group)),
      h(
        "details",
        { class: "card setup-more" },
        h("summary", {}, "Alarm rules and operating bins"),
        h("div", { class: "setup-rules" }, this.#rules.elements),
      ),
      this.#jsonEditor(),
      this.#result,
      h(
        "div",
        { class: "form-buttons" },
        this.#save,
        h("a", { class: "button", href: this.#wayBack(), onclick: () => this.#draft.clear() }, "Cancel"),
      ),
    );
    this.#draft = new SetupDraft(this.#form, () => this.#empty());
    this.#form.prepend(this.#draft.element);
    const side = h(
      "aside",
      { class: "setup-side" },
      h(
        "section",
        { class: "card" },
        h("h2", {}, "Gear pair to scale"),
        this.#drawing.element,
        this.#faults,
        this.#measures,
      ),
    );
    const title = h(
      "header",
      { class: "asset-header" },
      crumbs(["#/", "Fleet"]),
      this.#title,
      h(
        "p",
        { class: "muted" },
        "One gear mesh, or a machine without gears, measured by one or more accelerometers. Teeth and speed are enough for indicators; the gear pair adds wear in µm, and bearings add their fault lines.",
      ),
    );
    setChildren(
      root,
      title,
      h("div", { class: "settings-grid setup-grid" }, this.#form, side),
      h("h2", { class: "preview-title" }, "Wear preview"),
      this.#panel.element,
    );
    this.#fillChoices();
    this.#rules.fill({});
    this.#check(0);
    this.#name();
  }

  #wayBack() {
    const id = this.#query.edit ?? this.#query.copy;
    return id ? format({ page: "settings", id }) : "#/";
  }

  #name() {
    const { edit, copy } = this.#query;
    const words = edit ? `Edit ${edit}` : copy ? `Copy of ${copy}` : "New asset";
    setText(this.#title, words);
    setText(this.#save, edit ? "Save asset" : "Create asset");
    document.title = `${words} · flankwatch`;
  }

  #group({ title, fields, more, rare, pairChoice }) {
    const box = (list) =>
      h(
        "div",
        { class: "form-fields" },
        list.map((field) => this.#inputs.make(field)),
      );
    const choice =
      pairChoice &&
      h(
        "label",
        { class: "field setup-choice", for: "setup-pair" },
        h("span", {}, "Gear pair, for wear in µm"),
        this.#pair,
      );
    const folded = [more, rare]
      .filter(Boolean)
      .map((part) => h("details", { class: "setup-more" }, h("summary", {}, part.title), box(part.fields)));
    return h(
      "fieldset",
      { class: "card" },
      h("legend", {}, title),
      choice,
      box(fields),
      folded,
      this.#lists.of(title),
    );
  }

  #jsonEditor() {
    const words =
      "Anything without a field above, as API JSON, such as a measured wear profile. Fields above take precedence.";
    return h(
      "details",
      { class: "card setup-more" },
      h("summary", {}, "All other fields as JSON"),
      h("label", { class: "field", for: "setup-json" }, h("span", {}, words), this.#json),
      this.#jsonError,
    );
  }

  #fillChoices() {
    const options = [
      [NUMBERS, "Enter data"],
      ...this.#presets.map(({ name, pair }) => [name, `Start from: ${pair.name || name}`]),
      [NONE, "None: indicators only"],
      [NO_GEARS, "No gears: shaft and bearings only"],
    ];
    setChildren(
      this.#pair,
      options.map(([value, words]) => h("option", { value }, words)),
    );
  }

  /** Fetches the presets and the asset to start from, once. */
  async refresh(signal) {
    if (this.#asked) return;
    const id = this.#query.edit ?? this.#query.copy;
    const [presets, asset] = await Promise.all([
      api.answer(api.pairPresets(signal)),
      id ? api.answer(api.asset(id, signal)) : null,
    ]);
    this.#asked = true;
    if (!(presets instanceof Error)) this.#presets = presets.items;
    const chosen = this.#pair.value;
    this.#fillChoices();
    this.#pair.value = chosen;
    if (asset instanceof Error) return this.#showNotice("bad", `${asset.message}.`);
    if (asset) this.#begin(asset);
    else this.#restore();
  }

  /** Whether the form describes a new asset from nothing. */
  get #isNew() {
    return !this.#query.edit && !this.#query.copy;
  }

  #restore() {
    const { spec } = this.#draft;
    if (!spec) return;
    this.#fill(spec);
    this.#draft.restore();
    this.#idTyped = Boolean(spec.id);
    this.#check(0);
  }

  #begin(asset) {
    const description = structuredClone(asset);
    for (const name of FROM_SERVER) delete description[name];
    if (!this.#query.edit) {
      description.id = `${asset.id}-copy`.slice(0, 64);
      if (asset.name) description.name = `${asset.name}, copy`;
    }
    this.#idTyped = true;
    this.#pair.value = description.gear?.pair ? NUMBERS : description.gear ? NONE : NO_GEARS;
    this.#fill(description);
    this.#inputs.get("id").input.readOnly = Boolean(this.#query.edit);
    this.#check(0);
  }

  #fill(description) {
    const { alarms, operating_bins: bins, ...others } = description;
    this.#rules.fill({ alarms, operating_bins: bins });
    this.#lists.resize(others);
    const rest = this.#inputs.fill(others);
    this.#json.value = rest ? JSON.stringify(rest, null, 2) : "";
    this.#json.closest("details").open = false;
  }

  get #withPair() {
    return this.#shape.pair;
  }

  /** Whether the machine has gears, and whether their pair is described. */
  get #shape() {
    const mesh = this.#pair.value !== NO_GEARS;
    return { mesh, pair: mesh && this.#pair.value !== NONE };
  }

  #choosePair() {
    const preset = this.#presets.find(({ name }) => name === this.#pair.value);
    if (preset) {
      const { pair } = structuredClone(preset);
      const before = this.#description() ?? {};
      this.#fill({
        ...before,
        gear: {
          ...before.gear,
          teeth: pair.geometry.teeth,
          shaft_speed_hz: pair.operation.shaft_speed_hz,
          pair,
        },
      });
    }
    this.#check(0);
    this.#keepDraft();
  }

  /** The content of the JSON editor; null when it is invalid. */
  #rest() {
    const text = this.#json.value.trim();
    let words = "";
    let rest = {};
    try {
      rest = text ? JSON.parse(text) : {};
      if (typeof rest !== "object" || Array.isArray(rest) || rest === null)
        words = "expected an object in braces";
    } catch (error) {
      words = error.message;
    }
    this.#jsonError.hidden = !words;
    setText(this.#jsonError, words && `Other fields as JSON: ${words}`);
    this.#json.toggleAttribute("aria-invalid", false);
    if (words) this.#json.setAttribute("aria-invalid", "true");
    return words ? null : rest;
  }

  /** The current description; null when the JSON is invalid. */
  #description() {
    const spec = this.#entered();
    return spec && withoutGaps(spec);
  }

  /** The same with the empty entries of lists. */
  #entered() {
    const rest = this.#rest();
    if (!rest) return null;
    const spec = this.#inputs.description(rest, this.#shape);
    const { alarms, operating_bins: bins } = rest;
    this.#rules.put(spec);
    // those of the JSON, unless the form has some
    if (alarms) spec.alarms ??= alarms;
    if (bins) spec.operating_bins ??= bins;
    return spec;
  }

  #typed({ target }) {
    if (target === this.#pair) return;
    const [name, id] = [this.#inputs.get("name").input, this.#inputs.get("id").input];
    if (target === id) this.#idTyped = id.value !== "";
    if (target === name && !this.#idTyped) id.value = slug(name.value);
    if (target.closest(".preview")) return;
    this.#check(TYPED_MS);
    this.#keepDraft();
  }

  #keepDraft() {
    const spec = this.#isNew && this.#entered();
    if (spec) this.#draft.keep(spec);
  }

  /** Checks the input; the service checks the gear pair. */
  #check(wait) {
    this.#refusals.saved = [];
    this.#showNotice("", "");
    this.#inputs.show(this.#shape);
    this.#lists.show(this.#shape);
    for (const folded of this.#form.querySelectorAll("fieldset .setup-more"))
      folded.hidden = [...folded.querySelectorAll(".setup-field")].every(({ hidden }) => hidden);
    const spec = this.#description();
    this.#refusals.typed = [...(spec ? typedRefusals(spec) : []), ...this.#inputs.incomplete(this.#shape)];
    this.#showRefusals();
    if (!spec) return;
    if (!this.#withPair)
      return this.#blank(
        this.#shape.mesh
          ? "No preview without a gear pair: indicators are computed, but wear is not estimated."
          : "No preview without gears: records are judged by their indicators and novelty.",
      );
    const lacking = this.#inputs.lacking(this.#shape).filter(({ path }) => path !== "id");
    if (lacking.length) return this.#blank(requiredWords(lacking));
    this.#panel.describe(spec.gear, wait, spec.name || spec.id);
  }

  #blank(words) {
    this.#refusals.previewed = [];
    this.#showRefusals();
    this.#drawing.showNotice(words);
    this.#panel.lacking(
      this.#withPair
        ? "Enter the gear pair to preview its wear, or start from one of the pairs above."
        : words,
    );
    setChildren(this.#measures);
    setChildren(this.#faults);
  }

  #previewed({ refusals, geometry }) {
    const own = refusals.filter(({ field }) => !["wear_um", "torque_nm", "shaft_speed_hz"].includes(field));
    this.#refusals.previewed = own;
    const placed = this.#showRefusals();
    setChildren(
      this.#faults,
      own.filter((refusal) => !placed.has(refusal)).map(({ detail }) => h("li", {}, detail)),
    );
    if (geometry) this.#drawing.show(geometry);
    else this.#drawing.showNotice("These values do not define drawable gears.");
    showMeasures(this.#measures, geometry?.measures ?? []);
  }

  #refused({ problem, message }) {
    this.#refusals.previewed = problem?.field ? [problem] : [];
    if (!this.#showRefusals().size) this.#showNotice("bad", `${message}.`);
  }

  /** Shows the errors at their fields; returns those that have a field. */
  #showRefusals() {
    this.#inputs.clearErrors();
    this.#rules.clearErrors();
    const { typed, previewed, saved } = this.#refusals;
    return new Set(
      [...saved, ...typed, ...previewed].filter(
        (refusal) => this.#inputs.fail(refusal) || this.#rules.fail(refusal),
      ),
    );
  }

  async #submit(event) {
    event.preventDefault();
    const spec = this.#description();
    const lacking = this.#inputs.lacking(this.#shape);
    this.#refusals.saved = lacking.map(({ path }) => ({ field: path }));
    this.#showRefusals();
    if (lacking.length || !spec) {
      this.#showNotice("bad", spec ? requiredWords(lacking) : "The JSON is invalid.");
      return this.#inputs.focusError();
    }
    this.#save.disabled = true;
    try {
      const { id } = this.#query.edit
        ? await api.replaceAsset(this.#query.edit, spec)
        : await api.createAsset(spec);
      this.#draft.clear();
      go({ page: "asset", id });
    } catch (error) {
      const refusal =
        error.status === 409 ? { field: "id", value: spec.id, expected: "an unused id" } : error.problem;
      this.#refusals.saved = refusal ? [refusal] : [];
      const placed = this.#showRefusals().has(refusal);
      this.#showNotice(
        "bad",
        placed ? "Saving failed: a field is invalid." : `Saving failed: ${error.message}.`,
      );
      if (placed) this.#inputs.focusError();
    } finally {
      this.#save.disabled = false;
    }
  }

  #showNotice(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }

  /** Another source asset needs another form. */
  update({ query }) {
    if (query.copy === this.#query.copy && query.edit === this.#query.edit) return false;
    this.#query = query;
    this.#asked = false;
    this.#draft.element.hidden = true;
    this.#empty();
    this.#inputs.get("id").input.readOnly = false;
    this.#name();
    return true;
  }

  #empty() {
    this.#fill({});
    this.#pair.value = NUMBERS;
    this.#idTyped = false;
    this.#check(0);
  }

  /** Redraws in a changed theme. */
  redraw() {
    return this.#panel.redraw();
  }

  tick() {}

  dispose() {
    this.#panel.dispose();
  }
}
