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
