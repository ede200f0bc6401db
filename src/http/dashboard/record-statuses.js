// The statuses of records in words, as docs/api.md has them.

import { depth } from "./format.js";

/** Each status with its word and what it means. */
export const STATUSES = {
  estimated: ["Estimated", "a depth with its interval"],
  collecting_baseline: ["Collecting baseline", "the record teaches what healthy looks like"],
  no_library: ["No library", "no gear pair is described, so that there is nothing to compare with"],
  no_mesh: ["Like the baseline", "the machine has no gear mesh; the record is like the healthy ones"],
  speed_in_doubt: ["Speed in doubt", "the lines do not fit the described teeth and speed"],
  awaiting_library: ["Awaiting library", "the library to compare with is still simulated"],
  provisional: ["Provisional", "a first answer from a part of the library; the final one follows"],
  library_failed: ["Library failed", "the library could not be simulated"],
  no_features: ["No features", "the record gives nothing to compare"],
  not_comparable: [
    "Not comparable",
    "too short or too sparsely sampled for its baseline, or far from the described speed or torque",
  ],
  not_identifiable: ["Not identifiable", "the interval spans most of the library"],
  outside_library: ["Outside library", "wear does not explain the record"],
  sensor_fault: ["Sensor fault", "the sensor and not the machine is the reason"],
  recomputing: ["Recomputing", "the records before are computed again"],
  excluded: ["Excluded", "the record takes no part in the baseline, the estimate and the alarms"],
};

/** A record's status in a word, with the depth where there is one. */
export function statusWords({ status, median_um: median, p05_um: low, p95_um: high }) {
  const word = STATUSES[status]?.[0] ?? status.replaceAll("_", " ");
  return status === "estimated" && median != null
    ? `${depth(median)} µm (${depth(low)} to ${depth(high)})`
    : word;
}

/** What a status means. */
export const statusMeaning = (status) => STATUSES[status]?.[1] ?? "";
