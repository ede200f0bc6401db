// A record as text and figures, with those of a pinned record for comparison.

import { h } from "./dom.js";
import { absence, clock, count, hertz, indicatorName, number, recordLength, unit } from "./format.js";
import { depthWords, transmissionWords } from "./state.js";

const SHOWN = ["rms", "velocity_rms", "peak", "crest_factor", "kurtosis", "omx"];
const UNITS = { kurtosis: "", crest_factor: "", velocity_rms: "mm/s" };
const BEARING_RATIO = /^bearing_.+_to_background$/;

/** Channel, length, rate, speed and load of a record. */
export function recordWords(segment) {
  const length = segment.samples / segment.sample_rate_hz;
  const { torque_nm: torque, temperature_c: temperature } = segment.operating_point ?? {};
  const load = torque == null ? "" : `, ${number(torque)} N·m`;
  const warmth = temperature == null ? "" : `, ${number(temperature)} °C`;
  const speed = segment.shaft_speed ? `, shaft ${hertz(segment.shaft_speed.shaft_speed_hz)}` : "";
  return `Channel ${segment.channel}, ${recordLength(length)} at ${hertz(segment.sample_rate_hz)}, ${count(segment.samples)} samples${speed}${load}${warmth}`;
}

function amount(name, { indicators = {}, absent = {}, unit: unitName }) {
  const value = indicators[name];
  if (value == null) return h("span", { class: "muted" }, absence(absent[name] ?? "absent", unitName));
  if (BEARING_RATIO.test(name)) return `${number(value, 3)} ×`;
  return `${number(value)} ${UNITS[name] ?? unit(unitName)}`.trim();
}

/** The ISO 20816 zone beside the velocity, if the asset has zones. */
const zoneWords = (name, { velocity_zone: zone }) =>
  name === "velocity_rms" && zone ? h("span", { class: "muted" }, `zone ${zone}`) : null;

function fact(name, segment, pinned) {
  const before = pinned?.indicators?.[name];
  const now = segment.indicators?.[name];
  const ratio =
    before && now != null ? h("span", { class: "ratio" }, ` (× ${number(now / before, 3)})`) : null;
  const compared = pinned
    ? h("span", { class: "pinned-value" }, h("span", { class: "ratio" }, amount(name, pinned)), ratio)
    : null;
  return h(
    "div",
    { class: "fact" },
    h("dt", {}, indicatorName(name)),
    h("dd", {}, amount(name, segment), zoneWords(name, segment), compared),
  );
}

function wearFact(term, words) {
  return (
    words &&
    h(
      "div",
      { class: "fact wear-fact" },
      h("dt", {}, term),
      h("dd", {}, words.number, h("span", { class: "muted" }, words.interval)),
    )
  );
}

/** The wear estimate after the record. */
function wearFacts({ wear }) {
  if (wear?.median_um == null) return [];
  return [
    wearFact("Wear depth", depthWords(wear)),
    wearFact("Transmission error due to wear", transmissionWords(wear)),
  ].filter(Boolean);
}

/** The record's wear and main indicators, each with the pinned record's value and their ratio. */
export function recordFacts(segment, pinned) {
  const { indicators = {}, absent = {} } = segment;
  const ratios = Object.keys(indicators).filter((name) => BEARING_RATIO.test(name));
  return [
    ...wearFacts(segment),
    ...[...SHOWN, ...ratios]
      .filter((name) => name in indicators || name in absent)
      .map((name) => fact(name, segment, pinned)),
  ];
}

/** When the pinned record was taken. */
export function pinnedWords(pinned) {
  return pinned instanceof Error
    ? `The pinned record cannot be displayed: ${pinned.message}.`
    : `Pinned: ${clock(pinned.start_time)}, in the lower half of each plot; its values and the change since then are below.`;
}
