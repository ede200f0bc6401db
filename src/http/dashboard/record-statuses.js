// Record statuses as text, as in docs/api.md.

import { depth } from "./format.js";

/** Each status with its label and meaning. */
export const STATUSES = {
  estimated: ["Estimated", "a depth with its interval"],
  collecting_baseline: ["Collecting baseline", "the record is part of the healthy baseline"],
  no_library: ["No gear pair", "no gear pair is defined, so wear is not estimated"],
  no_mesh: ["Like the baseline", "the machine has no gear mesh; the record matches the baseline"],
  speed_in_doubt: ["Speed uncertain", "the lines do not fit the configured teeth and speed"],
  awaiting_library: ["Awaiting library", "the library is still being simulated"],
  provisional: ["Provisional", "a first estimate from part of the library; the final one follows"],
  library_failed: ["Library failed", "the library could not be simulated"],
  no_features: ["Not usable", "the record has nothing to compare with the baseline"],
  not_comparable: [
    "Not comparable",
    "too short or sampled too slowly for its baseline, or far from the configured speed or torque",
  ],
  not_identifiable: ["Not identifiable", "the records do not determine the depth"],
  outside_library: ["Outside library", "the record is not explained by wear"],
  sensor_fault: ["Sensor fault", "the sensor, not the machine, is at fault"],
  recomputing: ["Recomputing", "earlier records are being recomputed"],
  excluded: ["Excluded", "the record is not used for the baseline, the estimate or alarms"],
};

/** Statuses of records that change neither the baseline nor the estimate. */
export const UNUSED = ["no_features", "not_comparable", "speed_in_doubt", "sensor_fault"];

/** A record's status, or its wear depth if there is one. */
export function statusWords({ status, median_um: median, low_um: low, high_um: high }) {
  const word = STATUSES[status]?.[0] ?? status.replaceAll("_", " ");
  return status === "estimated" && median != null
    ? `${depth(median)} µm (${depth(low)} to ${depth(high)})`
    : word;
}

/** The meaning of a status. */
export const statusMeaning = (status) => STATUSES[status]?.[1] ?? "";
