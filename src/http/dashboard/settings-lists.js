// Lists in an asset's settings: alarm rules and operating bins, one row of fields per entry.

import { quantityWords, ruleLevels } from "./alarm-words.js";
import { h, setChildren } from "./dom.js";
import { Rows } from "./setting-rows.js";
import { tidy } from "./field-values.js";

const number = (text) => (text.trim() === "" ? undefined : Number(text));
const given = (object) =>
  Object.fromEntries(Object.entries(object).filter(([, value]) => value !== undefined));
const DEFAULT_SETTINGS = { raise: 3, raise_of: 5, clear: 5, clear_of: 5 };

const text = (attributes) => () => h("input", { type: "text", autocomplete: "off", ...attributes });
const whole = () => h("input", { type: "number", step: "1", min: "1" });
const KINDS = [
  ["wear_um", "Wear depth (µm)"],
  ["wear_above_limit", "Probability that the limit is exceeded"],
  ["novelty", "Novelty (−log₁₀ p)"],
  ["joint_novelty", "Joint novelty of all channels (−log₁₀ p)"],
  ["sensor_fault", "Sensor fault (0 or 1)"],
  ["stale_s", "Time without a record (s)"],
  ["indicator", "Indicator"],
  ["rate wear_um", "Change of wear depth (µm/day)"],
  ["rate novelty", "Change of novelty per day"],
  ["rate indicator", "Change of an indicator per day"],
];
const kinds = () =>
  h(
    "select",
    {},
    KINDS.map(([value, words]) => h("option", { value }, words)),
  );
const setting = (key) => (rule) => ({ ...DEFAULT_SETTINGS, ...rule.settings })[key];

const kindOf = (quantity) =>
  quantity?.rate_per_day
    ? `rate ${kindOf(quantity.rate_per_day)}`
    : quantity?.indicator
      ? "indicator"
      : quantity;

function quantityOf(kind, indicator) {
  if (kind.startsWith("rate ")) return { rate_per_day: quantityOf(kind.slice(5), indicator) };
  return kind === "indicator" ? { indicator } : kind;
}

const RULE = [
  { label: "Quantity", path: "quantity", value: ({ quantity }) => kindOf(quantity), input: kinds },
  {
    label: "Indicator",
    path: "quantity.indicator",
    value: ({ quantity }) => (quantity?.rate_per_day ?? quantity)?.indicator,
    input: text({ placeholder: "rms" }),
    place: "of-indicator",
  },
  { label: "Warning above", path: "warning", value: ({ warning }) => warning },
  { label: "Danger above", path: "danger", value: ({ danger }) => danger },
  { label: "Warning below", path: "warning_below", value: ({ warning_below: level }) => level },
  { label: "Danger below", path: "danger_below", value: ({ danger_below: level }) => level },
  { label: "Hysteresis", path: "hysteresis", value: ({ hysteresis }) => hysteresis },
  { label: "Change over (s)", path: "over_s", value: ({ over_s: over }) => over },
  {
    label: "Raised by",
    path: "settings.raise",
    value: setting("raise"),
    input: whole,
    place: "count",
    breaks: true,
  },
  { label: "of the last", value: setting("raise_of"), input: whole, place: "count" },
  { label: "Cleared by", path: "settings.clear", value: setting("clear"), input: whole, place: "count" },
  { label: "of the last", value: setting("clear_of"), input: whole, place: "count" },
];

function ruleOf([
  kind,
  indicator,
  warning,
  danger,
  warningBelow,
  dangerBelow,
  hysteresis,
  over,
  raise,
  raiseOf,
  clear,
  clearOf,
]) {
  const settings = {
    raise: number(raise),
    raise_of: number(raiseOf),
    clear: number(clear),
    clear_of: number(clearOf),
  };
  const levels = {
    warning: number(warning),
    danger: number(danger),
    warning_below: number(warningBelow),
    danger_below: number(dangerBelow),
  };
  return given({
    quantity: quantityOf(kind, indicator.trim()),
    ...levels,
    hysteresis: number(hysteresis),
    over_s: number(over),
    settings: { ...DEFAULT_SETTINGS, ...given(settings) },
  });
}

const rpm = (hz) => (hz == null ? hz : tidy(60 * hz));
const hertz = (text) => (text.trim() === "" ? text : String(tidy(Number(text) / 60)));

const BIN = [
  { label: "Name", path: "name", value: ({ name }) => name, input: text({ placeholder: "full load" }) },
  {
    label: "Shaft speed from (rpm)",
    path: "shaft_speed_hz",
    value: ({ shaft_speed_hz: range }) => rpm(range?.[0]),
  },
  { label: "up to", value: ({ shaft_speed_hz: range }) => rpm(range?.[1]) },
  { label: "Torque from (N·m)", path: "torque_nm", value: ({ torque_nm: range }) => range?.[0] },
  { label: "up to", value: ({ torque_nm: range }) => range?.[1] },
];

function binOf([name, speedLow, speedHigh, torqueLow, torqueHigh]) {
  const range = (low, high) =>
    low.trim() === "" && high.trim() === "" ? undefined : [number(low) ?? null, number(high) ?? null];
  return given({
    name: name.trim(),
    shaft_speed_hz: range(hertz(speedLow), hertz(speedHigh)),
    torque_nm: range(torqueLow, torqueHigh),
  });
}

const HYSTERESIS = 0.05; // of a rule that follows from limits, as a fraction of the lower one

/** The levels of the default rule for limits, as the service derives it. */
function levelsFor({ warning_um: warning, danger_um: danger }) {
  const isApart = warning != null && (danger == null || warning < danger);
  const hysteresis = tidy(HYSTERESIS * (warning ?? danger));
  return given({ warning: isApart ? warning : undefined, danger: danger ?? undefined, hysteresis });
}

/** Asks whether a custom rule on the wear depth follows the limits that were changed, and changes it. */
export function followLimits(spec, before) {
  const rule = spec.alarms?.find(({ quantity }) => quantity === "wear_um");
  const own = spec.limits ?? {};
  const of = (limits) => `${limits?.warning_um ?? ""}, ${limits?.danger_um ?? ""}`;
  if (!rule || of(own) === of(before?.limits) || of(own) === of({})) return;
  const { hysteresis, ...levels } = levelsFor(own);
  if (rule.warning === levels.warning && rule.danger === levels.danger) return;
  const wanted = ruleLevels({ quantity: rule.quantity, ...levels });
  if (!confirm(`The custom alarm rule on wear depth has ${ruleLevels(rule)}. Change it to ${wanted}?`))
    return;
  const isUsual =
    rule.hysteresis === levelsFor({ warning_um: rule.warning, danger_um: rule.danger }).hysteresis;
  delete rule.warning;
  delete rule.danger;
  Object.assign(rule, levels, isUsual && { hysteresis });
}

/** The fieldsets for alarm rules and operating bins. */
export class SettingLists {
  #own = h("input", { type: "checkbox", id: "setting-own-rules", onchange: () => this.#ownChanged() });
  #words = h("p", { class: "muted" });
  #defaults = h("ul", { class: "muted default-rules" });
  #rules = new Rows("rule", RULE, ruleOf, { quantity: "indicator" });
  #bins = new Rows("operating bin", BIN, binOf, {});
  #inForce = [];
  elements = [
    h(
      "fieldset",
      { class: "card" },
      h("legend", {}, "Alarms"),
      h("label", { class: "check", for: "setting-own-rules" }, this.#own, "Custom rules"),
      this.#words,
      this.#defaults,
      this.#rules.element,
    ),
    h(
      "fieldset",
      { class: "card" },
      h("legend", {}, "Operating bins"),
      h(
        "p",
        { class: "muted" },
        "Ranges of shaft speed and torque: trends within one bin are clearer. Each range includes its lower and excludes its upper end; either quantity may be omitted.",
      ),
      this.#bins.element,
    ),
  ];

  /** Shows an asset's lists. */
  fill(asset) {
    this.#inForce = asset.summary?.alarm_rules ?? this.#inForce;
    this.#own.checked = asset.alarms != null;
    this.#rules.fill(asset.alarms ?? []);
    this.#bins.fill(asset.operating_bins ?? []);
    this.#show();
  }

  #ownChanged() {
    // New rules start from those in force
    if (this.#own.checked && this.#rules.entries().length === 0) this.#rules.fill(this.#inForce);
    this.#show();
  }

  #show() {
    this.#rules.element.hidden = !this.#own.checked;
    this.#defaults.hidden = this.#own.checked;
    setChildren(
      this.#defaults,
      this.#inForce.map((rule) => h("li", {}, `${quantityWords(rule.quantity)}: ${ruleLevels(rule)}`)),
    );
    this.#words.textContent = this.#own.checked
      ? "Levels and hysteresis in the unit of the quantity. Custom rules do not follow the limits."
      : `By default, rules follow from the description${this.#inForce.length ? ":" : "; there are none."}`;
  }

  /** Shows an error of the lists at its row; returns the input with the error, or null for another error. */
  fail(problem) {
    const { field = "", value, expected } = problem;
    const [list, ...path] = field.split(".");
    const rows = { alarms: this.#rules, operating_bins: this.#bins }[list];
    return rows ? rows.fail(path.join("."), value, expected) : null;
  }

  /** Shows an error at number fields that contain something else; returns the first of them. */
  failBroken() {
    const rules = this.#own.checked ? this.#rules.failBroken() : undefined;
    const bins = this.#bins.failBroken();
    return rules ?? bins;
  }

  clearErrors() {
    for (const rows of [this.#rules, this.#bins]) rows.clearErrors();
  }

  /** Writes the lists into a description. */
  put(spec) {
    if (this.#own.checked) spec.alarms = this.#rules.entries();
    else delete spec.alarms;
    const bins = this.#bins.entries();
    if (bins.length) spec.operating_bins = bins;
    else delete spec.operating_bins;
  }
}
