// Why a record has no shaft angle, as far as that is known before the server is asked for orders.

const CAUSES = {
  no_speed:
    "the shaft speed was not found in this record. Check teeth and speed in the settings, or send the speed with the records",
  constant: "all samples of this record are equal",
  above_nyquist: "the mesh frequency lies above 42 % of the sampling rate",
  too_few_turns: "this record covers fewer than 4 whole turns of the shaft",
  speed_varies: "the shaft speed varies too much within this record",
};

const WITHOUT_GEARS =
  "on a machine without gears the shaft's angle is known only from a tachometer, and this record has none that can be used";

/** Why a record has no shaft angle, which orders and the average over a turn need; null if it may have one. */
export function angleAbsence(segment, asset) {
  if ([segment, asset].some((known) => known instanceof Error)) return null;
  if (!asset.gear) return segment.shaft_speed?.source === "tachometer" ? null : WITHOUT_GEARS;
  // The indicators over the shaft's angle are missing for the same reason
  return CAUSES[segment.absent?.fm4] ?? null;
}
