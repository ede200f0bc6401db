// Alarms as text and symbols: watched quantity, severity, state, and history.

import { unitOf } from "./alarm-units.js";
import { clock, depth, indicatorName, number, span, unit } from "./format.js";
import { badge } from "./symbols.js";

/** Alarm states; `open` ones need attention. */
export const ALARM_STATES = {
  unacknowledged: { word: "Unacknowledged", words: "raised and not acknowledged", open: true },
  returned_unacknowledged: {
    word: "Returned, unacknowledged",
    words: "back to normal, but not acknowledged",
    open: true,
  },
  acknowledged: { word: "Acknowledged", words: "raised and acknowledged", open: false },
  shelved: { word: "Shelved", words: "suppressed until a set time", open: false },
  normal: { word: "Normal", words: "no alarm", open: false },
};

/** The quantity that a rule watches. */
export function quantityWords(quantity) {
  if (quantity?.indicator) return indicatorName(quantity.indicator);
  if (quantity?.rate_per_day) return `Change per day: ${quantityWords(quantity.rate_per_day)}`;
  return (
    {
      wear_um: "Wear depth",
      wear_above_limit: "Probability that the limit is exceeded",
      novelty: "Novelty (−log₁₀ p)",
      joint_novelty: "Joint novelty of all channels (−log₁₀ p)",
      sensor_fault: "Sensor fault",
      stale_s: "Time without a record",
    }[quantity] ?? String(quantity)
  );
}

/** A reading or level of an alarm with its unit. */
export function reading(value, alarm) {
  const { quantity } = alarm;
  if (value == null) return "–";
  if (quantity === "wear_um") return `${depth(value)} µm`;
  if (quantity === "stale_s") return span(value);
  if (quantity?.rate_per_day === "wear_um") return `${number(value, 3)} µm/day`;
  if (quantity?.rate_per_day) return `${number(value, 3)} per day`;
  if (quantity?.indicator === "velocity_rms") return `${number(value, 3)} mm/s`;
  if (quantity?.indicator?.endsWith("_to_background")) return `${number(value, 3)} ×`;
  return `${number(value, 3)} ${quantity?.indicator ? unit(unitOf(alarm)) : ""}`.trim();
}

/** The level exceeded by a raised alarm, or the first level of one that is not raised. */
export function levelWords(alarm) {
  const { rule, severity, value } = alarm;
  if (!rule) return "";
  const sides = (name) =>
    [
      ["above", rule[name]],
      ["below", rule[`${name}_below`]],
    ].filter(([, level]) => level != null);
  /** @param {any[]} level */
  const words = ([side, level]) => `${side} ${reading(level, alarm)}`;
  if (severity) {
    const passed = sides(severity).filter(
      ([side, level]) => value == null || (side === "above" ? value > level : value < level),
    );
    return (passed.length ? passed : sides(severity)).map(words)[0] ?? "";
  }
  return ["warning", "danger"].flatMap((name) => sides(name).map((side) => `${name} ${words(side)}`))[0];
}

/** The levels of a rule; `alarm` has the unit. */
export const ruleLevels = (rule, alarm = rule) =>
  [
    ["warning above", rule.warning],
    ["danger above", rule.danger],
    ["warning below", rule.warning_below],
    ["danger below", rule.danger_below],
  ]
    .filter(([, level]) => level != null)
    .map(([words, level]) => `${words} ${reading(level, alarm)}`)
    .join(", ");

const SEVERITIES = { danger: ["danger", "Danger"], warning: ["warning", "Warning"] };

/** The severity symbol of an alarm with its label. */
export function severityBadge(severity, size = 20) {
  const [key, word] = SEVERITIES[severity] ?? ["normal", "Not raised"];
  return badge(key, size, word);
}

/** An alarm's state, with the end of shelving; lower case when used `within` a sentence. */
export function stateWords({ state, shelved_until: until }, within = false) {
  const { word: own } = ALARM_STATES[state] ?? { word: state };
  const word = within ? own.toLowerCase() : own;
  return state === "shelved" && until ? `${word} until ${clock(until)}` : word;
}

const ACTIONS = {
  acknowledge: "acknowledged",
  unshelve: "unshelved",
  comment: "comment",
  shelving_over: "no longer shelved: the time expired",
};

/** One history entry of an alarm. */
export function changeWords(change, alarm) {
  const { action, severity, value, state } = change;
  if (action?.shelve) return `shelved until ${clock(action.shelve.until)}`;
  if (action && !action.stale && !action.joint) return ACTIONS[action] ?? String(action).replaceAll("_", " ");
  const at = value == null ? "" : ` at ${reading(value, alarm)}`;
  if (severity) return `${severity} raised${at}`;
  return state === "normal" || state === "returned_unacknowledged"
    ? `back to normal${at}`
    : `${state.replaceAll("_", " ")}${at}`;
}
