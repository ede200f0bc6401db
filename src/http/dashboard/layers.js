// What a drawing lays over one another: the data of a record each, with its colour and its name.

import { palette } from "./plots.js";

/**
 * `pointed` stands before what is said of a point, `prefix` before the headings of its columns; a record that `isNamed` is in the legend also where it is the
 * only one.
 * @typedef {{ data: any, colour: string, name: string, pointed: string, prefix: string, isNamed?: boolean }} Layer
 */

/**
 * The selected record, and the pinned one where there is one to compare with.
 * @returns {Layer[]}
 */
export function selectedAndPinned(data, other) {
  const { accent, other: second } = palette();
  const selected = { data, colour: accent, name: "selected record", pointed: "", prefix: "" };
  if (!other || other instanceof Error) return [selected];
  const name = "pinned record";
  return [selected, { data: other, colour: second, name, pointed: `${name}, `, prefix: "pinned " }];
}

/**
 * The legend's entries of records.
 * @param {Layer[]} layers
 */
export function recordEntries(layers) {
  return layers.length > 1 || layers[0].isNamed
    ? layers.map(({ colour, name }) => ["line", colour, name])
    : [];
}

/**
 * The columns of records side by side; `columns(data)` gives those of one.
 * @param {Layer[]} layers
 */
export function recordColumns(layers, columns) {
  return layers.flatMap(({ data, prefix }) =>
    columns(data).map(([heading, values]) => [`${prefix}${heading}`, values]),
  );
}
