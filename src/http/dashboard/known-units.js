// The units that the service converts and computes velocity from.

import { h } from "./dom.js";

const KNOWN = ["m/s2", "mm/s2", "g", "mg", "m/s", "mm/s", "in/s", "m", "mm", "um"];
const SPELLINGS = ["m/s²", "m/s^2", "mm/s²", "mm/s^2", "µm"];

/** The id of the list of units that inputs offer. */
export const UNITS = "known-units";

/** The list itself, for the page that has such inputs. */
export const unitList = () =>
  h(
    "datalist",
    { id: UNITS },
    KNOWN.map((value) => h("option", { value })),
  );

/** What to say about a unit that is not known; nothing about a known one. */
export function unknownUnitWords(unit) {
  if (!unit || [...KNOWN, ...SPELLINGS].includes(unit)) return "";
  return `“${unit}” is stored as it is, but not converted, and velocity is not computed from it. Known units: ${KNOWN.join(", ")}.`;
}
