// Editor for an alarm rule on a time plot: levels are typed, dragged or suggested from the baseline, tried on
// the history, and saved.

import { reading } from "./alarm-words.js";
import * as api from "./api.js";
import { h, setOptions, setText } from "./dom.js";
import { clock, count, indicatorName, number, some, unit } from "./format.js";

const LEVELS = [
  ["warning", "Warning above", "warning"],
  ["danger", "Danger above", "danger"],
  ["warning_below", "Warning below", "warning"],
  ["danger_below", "Danger below", "danger"],
];
const TRY_AFTER_MS = 250;

const OF_THEIR_OWN = ["novelty", "wear_um"]; // watched quantities that are not indicators
const quantityOf = (name) => (OF_THEIR_OWN.includes(name) ? name : { indicator: name });
/** Whether a rule watches the quantity `name`. */
export const watches = (rule, name) =>
  OF_THEIR_OWN.includes(name) ? rule.quantity === name : rule.quantity?.indicator === name;

/**
 * The panel below a plot. `prefix` starts the ids of its fields. Calls `onDraft` when the displayed rule
 * changes and `onName(name)` when another indicator is selected.
 */
export class AlarmRulePanel {
  #onDraft;
  #asset;
  #channel;
  #name = null;
  #unit = "";
  #rule; // as edited
  #isChanged = false;
  #trying = new AbortController();
  #timer;
  #quantity;
  #inputs;
  #units = LEVELS.map(([key, label]) => [key, label, h("span")]);
  #k;
  #suggestion;
  #trial = h("p", { class: "rule-trial", role: "status" });
  #freezing = h(
    "p",
    { class: "muted", hidden: true },
    "Saving turns the default rules of this asset into custom rules, which no longer follow its limits.",
  );
  #result = h("p", { class: "result", role: "status" });
  #save = h("button", { type: "submit", class: "primary" }, "Save rule");
  #reset = h("button", { type: "button", onclick: () => this.#begin(true) }, "Undo changes");
  element;

  constructor(onDraft, onName, prefix = "rule") {
    this.#onDraft = onDraft;
    this.#quantity = h("select", { id: `${prefix}-quantity` });
    this.#k = h("input", { id: `${prefix}-k`, type: "number", min: 0, step: "any", value: 4 });
    this.#inputs = new Map(
      LEVELS.map(([key, label]) => [
        key,
        h("input", {
          id: `${prefix}-${key}`,
          type: "number",
          step: "any",
          "aria-label": label,
          oninput: () => (this.#isChanged = true), // from here on, news does not overwrite the levels
          onchange: () => this.#typed(),
        }),
      ]),
    );
    this.#quantity.addEventListener("change", () => onName(this.#quantity.value));
    const fields = this.#units.map(([key, , label]) =>
      h("label", { class: "field", for: `${prefix}-${key}` }, label, this.#inputs.get(key)),
    );
    this.#suggestion = h(
      "span",
      { class: "rule-suggest" },
      h("button", { type: "button", onclick: () => this.#suggest() }, "Suggest from baseline"),
      h("label", { class: "check", for: this.#k.id }, "mean +", this.#k, "σ"),
    );
    this.element = h(
      "form",
      {
        class: "rule-panel",
        hidden: true,
        "aria-label": "Alarm levels",
        onsubmit: (event) => this.#submit(event),
      },
      h(
        "div",
        { class: "fields" },
        h("label", { class: "field", for: this.#quantity.id }, h("span", {}, "Alarm on"), this.#quantity),
        fields,
      ),
      h("div", { class: "form-buttons" }, this.#suggestion, this.#save, this.#reset),
      this.#trial,
      this.#freezing,
      this.#result,
    );
  }

  /**
   * Shows the rule for indicator `name` among `names`, or hides the panel when there is none. Returns the
   * rules to draw.
   */
  show({ asset, channel, names, units, name }) {
    const rules = asset.summary.alarm_rules ?? [];
    const isShown = name !== undefined && names.includes(name);
    this.element.hidden = !isShown;
    if (!isShown) {
      this.#name = null;
      return rules;
    }
    const isOther = name !== this.#name || channel !== this.#channel || asset.id !== this.#asset?.id;
    const isNews = asset !== this.#asset;
    [this.#asset, this.#channel, this.#name, this.#unit] = [asset, channel, name, unit(units[name])];
    setOptions(
      this.#quantity,
      names.map((each) => [each, indicatorName(each)]),
    );
    this.#quantity.value = name;
    this.#freezing.hidden = Boolean(asset.alarms) || rules.length === 0;
    this.#suggestion.hidden = name === "wear_um"; // wear depth is measured from the baseline, so it has no baseline statistics
    for (const [, label, element] of this.#units)
      setText(element, this.#unit ? `${label} (${this.#unit})` : label);
    if (isOther) this.#showStatus("", "");
    if (isOther || (isNews && !this.#isChanged)) this.#begin(false);
    return [...rules.filter((rule) => !watches(rule, name)), this.#rule];
  }

  /** The levels that are set, for the handles on the plot. */
  levels() {
    if (this.#name === null) return [];
    return LEVELS.filter(([key]) => this.#rule?.[key] != null).map(([key, label, severity]) => ({
      key,
      value: this.#rule[key],
      severity,
      label: `${label}, ${indicatorName(this.#name)}`,
      words: `${number(this.#rule[key])} ${this.#unit}`.trim(),
    }));
  }

  /** Takes over a level that was dragged. */
  setLevel(key, value) {
    this.#inputs.get(key).value = value;
    this.#typed();
  }

  /** Starts from the rule in force, or from an empty one. */
  #begin(isAsked) {
    const inForce = this.#asset.summary.alarm_rules?.find((rule) => watches(rule, this.#name));
    this.#rule = structuredClone(inForce ?? { quantity: quantityOf(this.#name) });
    this.#isChanged = false;
    for (const [key, input] of this.#inputs) input.value = this.#rule[key] ?? "";
    if (isAsked) {
      this.#showStatus("", "");
      this.#onDraft();
    }
    this.#tryLater();
  }

  #typed() {
    for (const [key, input] of this.#inputs) {
      if (input.value.trim() === "") delete this.#rule[key];
      else this.#rule[key] = Number(input.value);
    }
    this.#isChanged = true;
    this.#showStatus("", "");
    this.#onDraft();
    this.#tryLater();
  }

  /** What the panel shows: a response to a question about another subject is dropped. */
  get #subject() {
    return JSON.stringify([this.#asset.id, this.#channel, this.#name]);
  }

  async #suggest() {
    const subject = this.#subject;
    const k = Number(this.#k.value);
    if (!(k > 0))
      return this.#showStatus("bad", `The factor is ${this.#k.value || "empty"}; enter a number above 0.`);
    try {
      const known = await api.baseline(this.#asset.id, this.#channel, this.#name);
      if (subject !== this.#subject) return;
      const { mean, standard_deviation: deviation, records } = known.items[0] ?? {};
      if (deviation == null)
        return this.#showStatus(
          "bad",
          `The baseline has ${some(records ?? 0, "value")} of ${indicatorName(this.#name)}; at least 2 are needed.`,
        );
      this.#inputs.get("warning").value = Number((mean + k * deviation).toPrecision(3));
      this.#inputs.get("danger").value = Number((mean + 2 * k * deviation).toPrecision(3));
      this.#typed();
      this.#showStatus(
        "good",
        `Baseline of ${some(records, "record")}: mean ${number(mean)}, σ ${number(deviation, 3)} ${this.#unit}. Warning at mean + ${number(k)} σ, danger at mean + ${number(2 * k)} σ.`,
      );
    } catch (error) {
      if (subject === this.#subject) this.#showStatus("bad", `No suggestion: ${error.message}.`);
    }
  }

  #tryLater() {
    clearTimeout(this.#timer);
    this.#trying.abort();
    if (this.levels().length === 0)
      return setText(
        this.#trial,
        "No level is set, so no alarm is raised. Enter a level or suggest one from the baseline.",
      );
    this.#timer = setTimeout(() => this.#try(), TRY_AFTER_MS);
  }

  async #try() {
    this.#trying = new AbortController();
    try {
      const trial = await api.tryRule(
        this.#asset.id,
        { rule: this.#rule, channel: this.#channel },
        this.#trying.signal,
      );
      setText(this.#trial, this.#trialWords(trial));
    } catch (error) {
      if (error.name !== "AbortError") setText(this.#trial, `Trial failed: ${error.message}.`);
    }
  }

  #trialWords({ records, readings, warnings, dangers, severity, changes }) {
    const without = readings < records ? `, of which ${count(readings)} have a value` : "";
    const base = `On the ${some(records, "record")} of channel ${this.#channel}${without}`;
    const raised = warnings + dangers;
    if (raised === 0) return `${base}, this rule would have raised no alarm.`;
    const kinds = [warnings && some(warnings, "warning"), dangers && some(dangers, "danger")]
      .filter(Boolean)
      .join(" and ");
    const first = changes.find((change) => change.severity);
    const at = first
      ? ` first at ${clock(first.time)} with ${reading(first.value, { quantity: this.#rule.quantity, asset_id: this.#asset.id, channel: this.#channel })};`
      : "";
    return `${base}, this rule would have raised ${some(raised, "alarm")} (${kinds}),${at} ${severity ?? "no alarm"} after the last record.`;
  }

  async #submit(event) {
    event.preventDefault();
    if (this.levels().length === 0)
      return this.#showStatus("bad", "Enter at least one level. To remove a rule, use the settings.");
    this.#save.disabled = true;
    const [subject, name, own] = [this.#subject, this.#name, structuredClone(this.#rule)];
    try {
      const asset = await api.asset(this.#asset.id); // keeps what others changed meanwhile
      const rules = asset.alarms ?? asset.summary.alarm_rules ?? [];
      const place = rules.findIndex((rule) => watches(rule, name));
      const alarms = place < 0 ? [...rules, own] : rules.with(place, own);
      await api.replaceAsset(asset.id, { ...asset, alarms }, asset);
      document.dispatchEvent(new CustomEvent("recordschange"));
      if (subject !== this.#subject) return;
      this.#isChanged = JSON.stringify(own) !== JSON.stringify(this.#rule); // edited while it was saved
      const isFrozen = !asset.alarms && rules.length > 0;
      this.#showStatus("good", isFrozen ? "Saved. The rules of this asset are now custom rules." : "Saved.");
    } catch (error) {
      const words =
        error.status === 412 ? "the asset was changed at the same moment; save again" : error.message;
      if (subject === this.#subject) this.#showStatus("bad", `Saving failed: ${words}.`);
    } finally {
      this.#save.disabled = false;
    }
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }

  /** Cancels pending requests. */
  dispose() {
    clearTimeout(this.#timer);
    this.#trying.abort();
  }
}
