// Values of a description that follow from others when they are not given.

import { USUAL_BORE } from "./gear-drawing.js";
import { valueAt } from "./field-values.js";

/**
 * The bore radius of a gear, 0 for the driving one, in mm: a third of its root radius, in two digits; undefined
 * while module or teeth are missing.
 */
export function usualBore(spec, gear) {
  const geometry = valueAt(spec, "gear.pair.geometry") ?? {};
  const { module_mm: module, teeth, dedendum, profile_shift: shift } = geometry;
  const count = teeth?.[gear];
  if (!(module > 0) || !(count > 0)) return undefined;
  const root = module * (count / 2 - (dedendum?.[gear] ?? 1.25) + (shift?.[gear] ?? 0));
  return root > 0 ? Number((USUAL_BORE * root).toPrecision(2)) : undefined;
}
