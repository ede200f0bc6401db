// An asset's state: its severity, and its category after NAMUR NE 107.

import { depth, featureName, number, span } from "./format.js";

/**
 * States, worst first. `severity` selects symbol and colour, the same for limits, alarms and states; `namur`
 * is the NE 107 signal; `title` explains states without a signal.
 */
export const STATES = {
  danger: { word: "Above danger limit", short: "Danger", severity: "danger", namur: "failure" },
  alarm_danger: { word: "Danger alarm", short: "Danger alarm", severity: "danger", namur: "failure" },
  warning: { word: "Above warning limit", short: "Warning", severity: "warning", namur: "maintenance" },
  alarm_warning: { word: "Warning alarm", short: "Warning alarm", severity: "warning", namur: "maintenance" },
  library_failed: {
    word: "Library failed",
    short: "Library failed",
    severity: "unsure",
    namur: "specification",
  },
  sensor: { word: "Sensor fault", short: "Sensor fault", severity: "danger", namur: "failure" },
  outside: {
    word: "Not explained by wear",
    short: "Not explained",
    severity: "unsure",
    namur: "specification",
  },
  not_comparable: {
    word: "Not comparable",
    short: "Not comparable",
    severity: "unsure",
    namur: "specification",
    title: "too short or sampled too slowly for its baseline, or far from the configured speed or torque",
  },
  speed_in_doubt: {
    word: "Speed uncertain",
    short: "Speed uncertain",
    severity: "unsure",
    namur: "specification",
    title: "the lines do not fit the configured teeth and speed",
  },
  unusable: {
    word: "Record not usable",
    short: "Not usable",
    severity: "unsure",
    namur: "specification",
    title: "the latest record has nothing to compare with the baseline",
  },
  unclear: {
    word: "Not identifiable",
    short: "Not identifiable",
    severity: "unsure",
    namur: "specification",
  },
  collecting: { word: "Collecting baseline", short: "Baseline", severity: "learning", namur: "check" },
  recomputing: { word: "Recomputing", short: "Recomputing", severity: "learning", namur: "check" },
  building: { word: "Building library", short: "Building library", severity: "learning", namur: "check" },
  normal: { word: "Normal", short: "Normal", severity: "normal" },
  unlimited: {
    word: "No limits set",
    short: "No limits",
    severity: "none",
    title: "wear is estimated, but there is no limit to compare it with",
  },
  no_library: {
    word: "Indicators only",
    short: "Indicators only",
    severity: "none",
    title: "no gear pair defined, so wear is not estimated",
  },
  empty: { word: "No records", short: "No records", severity: "none", title: "no records yet" },
};

const RANKS = Object.keys(STATES);

/** Position in the order of severity; 0 is the worst. */
export function rank(key) {
  return RANKS.indexOf(key);
}

/** The key into `STATES` of a wear estimate under limits. */
export function wearState(wear, limits) {
  if (wear.status === "collecting_baseline") return "collecting";
  if (wear.status === "no_library") return "no_library";
  if (wear.status === "no_mesh") return "normal";
  if (wear.status === "recomputing") return "recomputing";
  if (wear.status === "not_comparable") return "not_comparable";
  if (wear.status === "speed_in_doubt") return "speed_in_doubt";
  if (wear.status === "awaiting_library" || wear.status === "provisional") return "building";
  if (wear.status === "library_failed") return "library_failed";
  if (wear.status === "sensor_fault") return "sensor";
  if (wear.status === "outside_library") return "outside";
  if (wear.status === "no_features") return "unusable";
  if (wear.status !== "estimated") return "unclear";
  const { warning_um: warning, danger_um: danger } = limits ?? {};
  if (danger != null && wear.median_um >= danger) return "danger";
  if (warning != null && wear.median_um >= warning) return "warning";
  return danger == null && warning == null ? "unlimited" : "normal";
}

/** The key into `STATES` of a listed asset: its wear state, or a raised alarm if that is worse. */
export function assetState(asset) {
  return worse(ownState(asset, asset.summary.wear), asset.summary.alarms);
}

/** The state of one of several channels, with its latest estimate `wear` and its `alarms`. */
export function channelState(asset, wear, alarms) {
  const raised = (name) =>
    alarms.filter(({ severity, state }) => severity === name && state !== "shelved").length;
  return worse(ownState(asset, wear), { danger: raised("danger"), warning: raised("warning") });
}

function worse(key, { danger = 0, warning = 0 } = {}) {
  const alarm = danger ? "alarm_danger" : warning ? "alarm_warning" : null;
  return alarm && rank(alarm) < rank(key) && !(alarm === "alarm_warning" && key === "warning") ? alarm : key;
}

function ownState({ summary, limits }, wear) {
  if (summary.library_state === "failed") return "library_failed";
  if (summary.segments === 0) return "empty";
  if (summary.library_state === "building" && wear?.status !== "estimated") return "building";
  return wear ? wearState(wear, limits) : "empty";
}

/** Whether an estimate is a depth to judge; a provisional one is, until the final one replaces it. */
export const isUsable = (wear) =>
  wear?.median_um != null && ["estimated", "provisional"].includes(wear.status);

/** The next relevant limit and the fraction of it used; null without limits or a usable estimate. */
export function limitUse(wear, limits) {
  if (!isUsable(wear)) return null;
  const limit = limits?.danger_um ?? limits?.warning_um;
  return limit == null
    ? null
    : { limit, name: limits.danger_um != null ? "danger" : "warning", share: wear.median_um / limit };
}

/**
 * Wear and its interval as text: a median, or a lower bound when the interval reaches the end of the library;
 * “unclear” when the estimate is not usable.
 */
export function depthWords(wear) {
  const { status, at_least_um: least, median_um: median, low_um: low, high_um: high } = wear;
  const interval = `90 %: ${depth(low)} to ${depth(high)} µm`;
  if (!isUsable(wear)) return { number: "unclear", interval };
  if (least != null && status === "estimated")
    return {
      number: `at least ${depth(least)} µm`,
      interval: `with 95 % probability; median ${depth(median)} µm`,
    };
  return { number: `${depth(median)} µm`, interval };
}

/** The transmission error due to wear as text; null when unknown. */
export function transmissionWords(wear) {
  const { transmission_error_um: error } = wear;
  if (!error || !isUsable(wear)) return null;
  const um = (value) => (value < 0.05 ? "0" : number(value, 2));
  return { number: `${um(error.median)} µm`, interval: `90 %: ${um(error.p05)} to ${um(error.p95)} µm` };
}

/** A sentence with its full stop, unless it is a question. */
export const ended = (text) => (text.endsWith("?") ? text : `${text}.`);

/** A text with a capital letter. */
export const capital = (text) => (text ? text[0].toUpperCase() + text.slice(1) : "");

/** A summary of the wear with a recommendation, in one or two sentences. */
export function sentence(wear, limits, hasPair = true, hasMesh = true) {
  if (!wear) return "No records yet.";
  const { have, need } = wear.baseline ?? {};
  if (wear.status === "collecting_baseline" && !hasPair) {
    const why = hasMesh ? " Wear in µm is not estimated, because this asset has no gear pair." : "";
    return `Collecting the baseline: ${have} of ${need} records. After that, deviating records are flagged.${why}`;
  }
  if (wear.status === "collecting_baseline") {
    return `Collecting the baseline: ${have} of ${need} records. Wear is estimated after that.`;
  }
  if (wear.status === "no_library")
    return "This asset has no gear pair, so wear in µm is not estimated. Indicators are computed, and deviations from the baseline show up as novelty.";
  if (wear.status === "no_mesh")
    return "The machine has no gear mesh, so there is no wear to estimate. The record matches the baseline.";
  if (wear.status === "awaiting_library")
    return "The library of the gear pair is being simulated. Records are stored with their indicators; their wear is estimated when it is complete.";
  if (wear.status === "provisional")
    return `Provisional: the rest of the library is still being simulated. ${capital(wear.reason)}.`;
  if (wear.status === "library_failed")
    return `Wear is not estimated: ${wear.reason}. Records are stored with their indicators. Change the asset's settings to try again.`;
  if (wear.status === "excluded")
    return "This record is excluded from the baseline, the estimate and alarms.";
  if (wear.status === "not_comparable") return `This record is ${wear.reason}.`;
  if (wear.status === "speed_in_doubt") return ended(`This record is not used: ${wear.reason}`);
  if (wear.status === "no_features") return `The record cannot be judged: ${wear.reason}.`;
  if (wear.status === "sensor_fault")
    return `The record cannot be judged: ${wear.reason}. Check the sensor first.`;
  if (wear.status === "outside_library") return unexplained(wear, hasPair);
  if (wear.status === "recomputing") return "Earlier records are being recomputed; the estimate follows.";
  if (wear.status === "not_identifiable")
    return `The wear depth cannot be identified from the records: ${wear.reason}.`;
  const { low_um: low, high_um: high } = wear;
  const certain =
    wear.at_least_um != null
      ? `With 95 % probability the greatest wear depth is at least ${depth(wear.at_least_um)} µm; it may be beyond the end of the library.`
      : `With 90 % probability the greatest wear depth lies between ${depth(low)} and ${depth(high)} µm.`;
  return `${certain} ${transmissionSentence(wear)}${outlook(wear, limits)}`.trim();
}

function transmissionSentence(wear) {
  const words = transmissionWords(wear);
  return words ? `The transmission error due to wear is ${words.number} (${words.interval}). ` : "";
}

function outlook(wear, limits) {
  const { warning_um: warning, danger_um: danger } = limits ?? {};
  const key = wearState(wear, limits);
  if (key === "danger")
    return `The median is above the danger limit of ${depth(danger)} µm: stop the machine.`;
  if (key === "warning")
    return `The median is above the warning limit of ${depth(warning)} µm: plan maintenance.`;
  const next = warning ?? danger;
  if (next == null) return "No limits are set for this asset.";
  const name = warning != null ? "warning" : "danger";
  return wear.high_um >= next
    ? `The median is below the ${name} limit of ${depth(next)} µm, but the interval reaches past it.`
    : `The whole interval is below the ${name} limit of ${depth(next)} µm.`;
}

const AGED = 0.1; // age of the last record, as a fraction of the remaining time, above which time is counted from it and not from now

/** The strongest line of a record's envelope, as a sentence; empty when none stands out. */
function envelopeWords(line) {
  if (!line) return "";
  const { frequency_hz: frequency, to_background: ratio, source } = line;
  const of =
    source?.kind === "bearing"
      ? `, ${source.harmonic} × ${source.line.toUpperCase()} of bearing ${source.bearing}`
      : source
        ? `, ${source.harmonic} × the shaft rate`
        : "";
  return ` The strongest envelope line is at ${number(frequency, 4)} Hz${of}, ${number(ratio, 2)} times its background.`;
}

/** Describes deviations that wear does not explain; without a gear pair, deviations from the baseline. */
function unexplained({ novelty, reason }, hasPair) {
  const most = (novelty?.most ?? []).filter(({ deviations }) => Math.abs(deviations) > 3);
  const what = hasPair ? "Change not explained by wear" : "Change since the baseline";
  if (most.length === 0) return `${what}: ${reason}.`;
  const words = most
    .map(({ feature, ln_ratio: ratio }) => `${featureName(feature)}, × ${number(Math.exp(ratio), 2)}`)
    .join("; ");
  return `${what}${hasPair ? ". Relative to the best wear state" : ""}: ${words}. Check bearings, mounting and load.${envelopeWords(novelty?.envelope_line)}`;
}

/** The time until the limit is reached, from the prognosis after the record of `last`; null when unknown. */
export function timeToLimit(wear, last = wear?.start_time, now = Date.now()) {
  const { prognosis } = wear ?? {};
  if (!prognosis) return null;
  const recorded = Date.parse(last);
  // After an old record it is unknown whether the gear kept running, so the time counts from that record
  const aged = now - recorded > AGED * (Date.parse(prognosis.median) - recorded);
  const seconds = (time) => (Date.parse(time) - (aged ? recorded : now)) / 1000;
  const words = (time) => (seconds(time) <= 0 && !aged ? "now" : span(Math.max(0, seconds(time))));
  const late = prognosis.p95 ? words(prognosis.p95) : "much later";
  return {
    seconds: seconds(prognosis.median),
    median: words(prognosis.median),
    interval: `${words(prognosis.p05)} to ${late}`,
    from: aged ? "after the last record" : "from now",
    date: prognosis.median,
    limit: prognosis.limit_um,
    rate: prognosis.rate_um_per_day,
  };
}
