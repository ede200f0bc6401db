// Alarms in words and symbols: what is watched, how bad it is, where the alarm stands, and what happened to
// it.

import { unitOf } from "./alarm-units.js";
import { h } from "./dom.js";
import { clock, depth, indicatorName, number, span, unit } from "./format.js";
import { badge } from "./symbols.js";

/** Where an alarm stands; `open` ones ask for somebody. */
export const ALARM_STATES = {
  unacknowledged: { word: "Unacknowledged", words: "raised, and nobody has said that they know", open: true },
  returned_unacknowledged: {
    word: "Returned, unacknowledged",
    words: "it was raised and is over, and nobody has said that they know",
    open: true,
  },
  acknowledged: { word: "Acknowledged", words: "raised, and somebody knows", open: false },
  shelved: { word: "Shelved", words: "put aside until a time", open: false },
  normal: { word: "Normal", words: "nothing is raised", open: false },
};

/** What a rule watches. */
export function quantityWords(quantity) {
  if (quantity?.indicator) return indicatorName(quantity.indicator);
  if (quantity?.rate_per_day) return `Change a day: ${quantityWords(quantity.rate_per_day)}`;
  return (
    {
      wear_um: "Wear depth",
      wear_above_limit: "Probability of having passed the limit",
      novelty: "Novelty (−log₁₀ of the p-value)",
      joint_novelty: "Novelty of all channels together (−log₁₀ p)",
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
  if (quantity?.rate_per_day === "wear_um") return `${number(value, 3)} µm a day`;
  if (quantity?.rate_per_day) return `${number(value, 3)} a day`;
  return `${number(value, 3)} ${quantity?.indicator ? unit(unitOf(alarm)) : ""}`.trim();
}

/** The level that a raised alarm is beyond, or where one begins that is not raised. */
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

const SEVERITIES = { danger: ["danger", "Danger"], warning: ["warning", "Warning"] };

/** The symbol of an alarm's severity with its word. */
export function severityBadge(severity, size = 20) {
  const [key, word] = SEVERITIES[severity] ?? ["normal", "Not raised"];
  return badge(key, size, word);
}

/** An alarm's state in a word, and until when it is shelved; `within` a sentence it begins small. */
export function stateWords({ state, shelved_until: until }, within = false) {
  const { word: own } = ALARM_STATES[state] ?? { word: state };
  const word = within ? own.toLowerCase() : own;
  return state === "shelved" && until ? `${word} until ${clock(until)}` : word;
}

const ACTIONS = {
  acknowledge: "acknowledged",
  unshelve: "unshelved",
  comment: "comment",
  shelving_over: "no longer shelved: its time was over",
};

/** One entry of an alarm's history in words. */
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
