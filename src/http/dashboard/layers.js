// Layers of a drawing: the data of one record each, with colour and name.

import { palette } from "./plots.js";

/**
 * `pointed` precedes hover text, `prefix` precedes column headings. A record with `isNamed` is in the legend
 * even if it is the only one. `speed` is the shaft speed in Hz if it is certain, `start` the start time.
 * @typedef {{
 *   data: any, colour: string, name: string, pointed: string, prefix: string,
 *   isNamed?: boolean, speed?: number, start?: string,
 * }} Layer
 */

/**
 * The selected record, and the pinned one if any.
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
 * Legend entries of records.
 * @param {Layer[]} layers
 */
export function recordEntries(layers) {
  return layers.length > 1 || layers[0].isNamed
    ? layers.map(({ colour, name }) => ["line", colour, name])
    : [];
}

/**
 * The columns of several records side by side; `columns(data)` returns those of one.
 * @param {Layer[]} layers
 */
export function recordColumns(layers, columns) {
  return layers.flatMap(({ data, prefix }) =>
    columns(data).map(([heading, values]) => [`${prefix}${heading}`, values]),
  );
}
