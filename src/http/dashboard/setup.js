// The form for a new, copied or existing asset, with a live drawing and preview of its gear pair.

import * as api from "./api.js";
import { crumbs, INVALID, savingWords } from "./asset-frame.js";
import { h, setChildren, setText } from "./dom.js";
import { PreviewPanel } from "./preview-panel.js";
import { format, go } from "./route.js";
import { unitList } from "./known-units.js";
import { reachWords } from "./field-values.js";
import { SETUP_GROUPS } from "./setup-fields.js";
import { PairGeometry } from "./setup-geometry.js";
import { SetupInputs } from "./setup-inputs.js";
import { JsonPart } from "./setup-json.js";
import { SetupDraft } from "./setup-draft.js";
import { SetupLists, withoutGaps } from "./setup-lists.js";
import { PairChoice } from "./setup-pair.js";
import { requiredWords, typedRefusals } from "./setup-refusals.js";
import { followLimits, SettingLists } from "./settings-lists.js";

const TYPED_MS = 250; // ms without typing before a preview is requested
const FROM_SERVER = ["summary", "created_at", "updated_at"];

/** Derives an id from a name. */
const slug = (name) =>
  name
    .toLowerCase()
    .normalize("NFKD")
    .replaceAll(/\p{M}/gu, "") // ü is u with a mark
    .replaceAll(/[^a-z0-9_]+/g, "-")
    .replaceAll(/^[-_]+|-+$/g, "")
    .slice(0, 64);

/** The page at `#/new`; `copy` or `edit` in its address names an asset. */
export class SetupPage {
  holdsEntries = true;
  #query;
  #inputs = new SetupInputs();
  #lists = new SetupLists(this.#inputs, () => this.#check(TYPED_MS));
  #rules = new SettingLists();
  #asked = false;
  #edited; // the asset as it was fetched
  #isTouched = false;
  #idTyped = false;
  /** Errors by source: the page, the latest preview, the latest attempt to save. */
  #refusals = { typed: [], previewed: [], saved: [] };
  #title = h("h1", {}, "New asset");
  #pair = new PairChoice(() => this.#choosePair());
  #json = new JsonPart();
  #result = h("p", { class: "result", role: "status" });
  #save = h("button", { type: "submit", class: "primary" }, "Create asset");
  #geometry = new PairGeometry();
  #reach = h("p", { class: "muted", hidden: true }); // below the limits
  #most; // µm of wear that can be estimated for the pair
  #ofGears; // what is beside and below the form
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
      this.#json.element,
      this.#result,
      h(
        "div",
        { class: "form-buttons" },
        this.#save,
        h("a", { class: "button", href: this.#wayBack(), onclick: () => this.#discard() }, "Cancel"),
      ),
    );
    this.#draft = new SetupDraft(this.#form, () => this.#empty());
    this.#form.prepend(this.#draft.element);
    const title = h(
      "header",
      { class: "asset-header" },
      crumbs(["#/", "Fleet"]),
      this.#title,
      h(
        "p",
        { class: "muted" },
        "One gear mesh, or a machine without gears, measured by one or more accelerometers. Teeth and speed are enough for indicators; the gear pair adds wear in µm, and bearings add their fault lines. Fields marked * are required.",
      ),
    );
    const beside = h("aside", { class: "setup-side" }, this.#geometry.element);
    const below = h("h2", { class: "preview-title" }, "Wear preview");
    this.#ofGears = [beside, below, this.#panel.element, this.#pair.hint];
    setChildren(
      root,
      title,
      h("div", { class: "settings-grid setup-grid" }, this.#form, beside),
      below,
      this.#panel.element,
      unitList(),
    );
    this.#rules.fill({});
    this.#check(0);
    this.#name();
    // Before anything can be entered; the chosen preset once the presets are there
    if (this.#isNew) this.#restore();
  }

  /** Whether leaving the page loses entries; those of a new asset are kept as a draft. */
  get hasUnsaved() {
    return this.#isTouched && !this.#isNew;
  }

  #discard() {
    this.#isTouched = false;
    this.#draft.clear();
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
    const folded = [more, rare]
      .filter(Boolean)
      .map((part) => h("details", { class: "setup-more" }, h("summary", {}, part.title), box(part.fields)));
    return h(
      "fieldset",
      { class: "card" },
      h("legend", {}, title),
      pairChoice && this.#pair.element,
      box(fields),
      title === "Limits on wear depth" && this.#reach,
      folded,
      this.#lists.of(title),
    );
  }

  /** Fetches the presets and the asset to start from, once. */
  async refresh(signal) {
    if (this.#asked) return;
    const id = this.#query.edit ?? this.#query.copy;
    const [presets, asset] = await Promise.all([
      api.settle(api.pairPresets(signal)),
      id ? api.settle(api.asset(id, signal)) : null,
    ]);
    this.#asked = true;
    if (!(presets instanceof Error)) this.#pair.offer(presets.items);
    if (asset instanceof Error) return this.#showNotice("bad", `${asset.message}.`);
    if (asset) this.#begin(asset);
    else if (!this.#isTouched) this.#restore();
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
    this.#edited = asset;
    const description = structuredClone(asset);
    for (const name of FROM_SERVER) delete description[name];
    if (!this.#query.edit) {
      description.id = `${asset.id}-copy`.slice(0, 64);
      if (asset.name) description.name = `${asset.name}, copy`;
    }
    this.#idTyped = Boolean(this.#query.edit);
    this.#pair.showKind(description);
    this.#fill(description);
    this.#inputs.get("id").input.readOnly = Boolean(this.#query.edit);
    this.#check(0);
  }

  #fill(description) {
    const { alarms, operating_bins: bins, ...others } = description;
    this.#rules.fill({ alarms, operating_bins: bins });
    this.#lists.resize(others);
    const rest = this.#inputs.fill(others);
    this.#json.write(rest);
  }

  #choosePair() {
    const { preset } = this.#pair;
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

  /** The current description; null when the JSON is invalid. */
  #description() {
    const spec = this.#entered();
    return spec && withoutGaps(spec);
  }

  /** The same with the empty entries of lists. */
  #entered() {
    const rest = this.#json.read();
    if (!rest) return null;
    const spec = this.#inputs.description(rest, this.#pair.shape);
    const { alarms, operating_bins: bins } = rest;
    this.#rules.put(spec);
    // Those of the JSON, unless the form has some
    if (alarms) spec.alarms ??= alarms;
    if (bins) spec.operating_bins ??= bins;
    return spec;
  }

  #typed({ target }) {
    if (target === this.#pair.input) return;
    const [name, id] = [this.#inputs.get("name").input, this.#inputs.get("id").input];
    if (target === id) this.#idTyped = id.value !== "";
    if (target === name && !this.#idTyped) id.value = slug(name.value);
    if (target.closest(".preview")) return;
    this.#check(TYPED_MS);
    this.#keepDraft();
  }

  #keepDraft() {
    this.#isTouched = true;
    const spec = this.#isNew && this.#entered();
    if (spec) this.#draft.keep(spec);
  }

  /** Checks the input; the service checks the gear pair. */
  #check(wait) {
    this.#refusals.saved = [];
    this.#showNotice("", "");
    this.#inputs.show(this.#pair.shape, this.#most);
    this.#lists.show(this.#pair.shape);
    for (const part of this.#form.querySelectorAll("fieldset:has(.setup-field), fieldset .setup-more"))
      part.hidden = [...part.querySelectorAll(".setup-field")].every(({ hidden }) => hidden);
    for (const part of this.#ofGears) part.hidden = !this.#pair.shape.mesh;
    const spec = this.#description();
    this.#refusals.typed = [
      ...(spec ? typedRefusals(spec) : []),
      ...this.#inputs.incomplete(this.#pair.shape),
    ];
    this.#showRefusals();
    if (!spec) return;
    if (!this.#pair.shape.pair)
      return this.#blank(
        this.#pair.shape.mesh
          ? "No preview without a gear pair: indicators are computed, but wear is not estimated."
          : "No preview without gears: records are judged by their indicators and novelty.",
      );
    if (this.#inputs.isBroken(this.#pair.shape, "gear."))
      return this.#blank("Correct the marked fields for a preview.");
    const lacking = this.#inputs.lacking(this.#pair.shape).filter(({ path }) => path !== "id");
    if (lacking.length) return this.#blank(requiredWords(lacking));
    this.#panel.describe(spec.gear, wait, spec.name || spec.id);
  }

  /** Shows how deep wear can be estimated for the pair, and which limits are deeper. */
  #showReach(most) {
    this.#most = most ?? undefined;
    this.#reach.hidden = !this.#most;
    setText(this.#reach, reachWords(this.#most));
    this.#inputs.warn(this.#most);
  }

  #blank(words) {
    this.#showReach();
    this.#refusals.previewed = [];
    this.#showRefusals();
    this.#geometry.showNotice(words);
    this.#panel.lacking(
      this.#pair.shape.pair
        ? "Enter the gear pair to preview its wear, or start from one of the pairs above."
        : words,
    );
  }

  #previewed({ refusals, geometry, max_wear_um: most }) {
    this.#showReach(most);
    const own = refusals.filter(({ field }) => !["wear_um", "torque_nm", "shaft_speed_hz"].includes(field));
    this.#refusals.previewed = own;
    const placed = this.#showRefusals();
    const unplaced = own.filter((refusal) => !placed.has(refusal));
    this.#geometry.show(geometry, unplaced);
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
    this.#isTouched = true; // presets that arrive later leave the errors on the page
    const spec = this.#description();
    const lacking = this.#inputs.lacking(this.#pair.shape);
    this.#refusals.saved = lacking.map(({ path }) => ({ field: path }));
    this.#showRefusals();
    if (lacking.length || !spec) {
      this.#showNotice("bad", spec ? requiredWords(lacking) : "The JSON is invalid.");
      return this.#inputs.focusError();
    }
    const listed = this.#rules.failBroken();
    if (listed || this.#inputs.isBroken(this.#pair.shape)) {
      this.#showNotice("bad", INVALID);
      if (listed) listed.closest("details").open = true;
      listed?.focus();
      return this.#inputs.focusError();
    }
    this.#save.disabled = true;
    followLimits(spec, this.#edited);
    try {
      const { id } = this.#query.edit
        ? await api.replaceAsset(this.#query.edit, spec, this.#edited)
        : await api.createAsset(spec);
      this.#discard();
      go({ page: "asset", id });
    } catch (error) {
      const refusal =
        error.status === 409 ? { field: "id", value: spec.id, expected: "an unused id" } : error.problem;
      this.#refusals.saved = refusal ? [refusal] : [];
      const placed = this.#showRefusals().has(refusal);
      this.#showNotice("bad", placed ? INVALID : savingWords(error));
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
    this.#asked = this.#isTouched = false;
    this.#draft.element.hidden = true;
    this.#empty();
    this.#inputs.get("id").input.readOnly = false;
    this.#name();
    return true;
  }

  #empty() {
    this.#fill({});
    this.#pair.reset();
    this.#idTyped = false;
    this.#check(0);
  }

  /** Redraws in a changed theme. */
  redraw() {
    return this.#panel.redraw();
  }

  dispose() {
    this.#panel.dispose();
  }
}
