// Values of form fields: at the paths of a description, in their units, and words about limits.

import { depth } from "./format.js";

/** How deep wear can be estimated; empty when unknown. */
export const reachWords = (most) =>
  most ? `Wear can be estimated up to ${depth(most)} µm for this pair.` : "";

/** A warning about a limit above the greatest wear that can be estimated; empty for others. */
export const beyondWords = (limit, most) =>
  most && limit > most ? `No estimate reaches this limit: wear is estimated up to ${depth(most)} µm.` : "";

/** Removes the rounding noise of a unit factor from a number. */
export const tidy = (value) => Number(value.toPrecision(12));

/** The value at a path of an object; undefined when missing. */
export function valueAt(object, path) {
  return path.split(".").reduce((inner, key) => inner?.[key], object);
}

/**
 * Sets a value at a path and creates missing parents; undefined deletes the value, and a list that becomes
 * empty.
 */
export function putAt(object, path, value) {
  const keys = path.split(".");
  const last = keys.pop();
  const inner = keys.reduce(
    (at, key, place) => (at[key] ??= Number.isInteger(Number(keys[place + 1] ?? last)) ? [] : {}),
    object,
  );
  if (value === undefined) delete inner[last];
  else inner[last] = value;
  if (Array.isArray(inner) && inner.every((each) => each === undefined))
    putAt(object, keys.join("."), undefined);
}

/** What a number field should have in place of its text; null if it is empty or has a number of its kind. */
export const brokenWords = ({ validity, step }) =>
  validity.badInput || validity.stepMismatch ? (step === "1" ? "a whole number" : "a number") : null;

const NUMBER = /(?<![\w.])\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])/g;
const BOUND = /^(?:a number|a fraction|at (?:most|least)|(?:less|more) than|above|from)\b/;
const LOWER = /(?:at least|above|more than|from) $/;

/** Four digits of a bound, rounded to the side of the accepted values. */
function fourDigits(value, isLower) {
  if (Number(value.toPrecision(4)) === value) return value;
  const unit = 10 ** (Math.floor(Math.log10(value)) - 3);
  return tidy((isLower ? Math.ceil : Math.floor)(value / unit) * unit);
}

/** What the service expects, with the numbers in the unit of the field. */
export function boundWords(expected, { factor = 1, unit }) {
  const end = expected.search(/[:,]|$/);
  const reason = expected.slice(end).replace(/\d+\.\d{4,}/g, (text) => String(fourDigits(Number(text))));
  let bound = expected.slice(0, end).replace(NUMBER, (text, place) => {
    const value = fourDigits(tidy(Number(text) / factor), LOWER.test(expected.slice(0, place)));
    return value === Number(text) ? text : String(value);
  });
  if (unit && BOUND.test(bound) && /\d/.test(bound))
    bound = `${bound.replace(/^a fraction/, "a number")} ${unit}`;
  return bound + reason;
}

/** Of fields with an error together, those outside the expected range; all if none is. */
export function outsideRange(own, expected, valueOf) {
  const [, low, high] = /\bfrom (\S+) to ([^\s,:]+)/.exec(expected ?? "") ?? [];
  const outside = own.filter((made) => valueOf(made) < Number(low) || valueOf(made) > Number(high));
  return outside.length ? outside : own;
}
