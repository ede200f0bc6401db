// A match as text: its certainty, its evidence, and its limits.

import { agreement } from "./agreement.js";
import { h } from "./dom.js";
import { clock, depth, featureName, number } from "./format.js";
import { format } from "./route.js";
import { depthWords, transmissionWords, wearState } from "./state.js";
import { badge } from "./symbols.js";

function fact(term, ...words) {
  return h("div", { class: "fact" }, h("dt", {}, term), h("dd", {}, ...words));
}

const small = (text) => h("span", { class: "muted" }, text);

function wearFacts(wear) {
  const [depths, error] = [depthWords(wear), transmissionWords(wear)];
  return [
    fact("Wear depth", depths.number, small(depths.interval)),
    error && fact("Transmission error due to wear", error.number, small(error.interval)),
  ];
}

function agreementFact({ features }) {
  const { used, odd } = agreement(features);
  const names = odd
    .slice(0, 3)
    .map(({ name }) => featureName(name))
    .join(", ");
  return fact(
    "Agreement with the model",
    `${used.length - odd.length} of ${used.length} features`,
    small(odd.length ? `outside: ${names}${odd.length > 3 ? "…" : ""}` : "all agree"),
  );
}

const SENSOR_FAULTS = {
  dead: "no signal from the sensor",
  clipped: "the signal is clipped",
  gaps: "samples are missing",
  gain_changed: "the sensor's gain has changed",
  loose_mount: "the sensor's mount is loose",
};

const SUSPECTED_FAULTS = {
  one_tooth: "one tooth differs from the others: crack or chip",
  shaft_lines: "the shaft's own lines have grown: misalignment or unbalance",
  impulsive_energy: "impulsiveness has increased: bearing or looseness",
  band_energy: "energy has increased: bearing, looseness or another machine",
};

/** Why a record is not explained by wear; null when no cause is known. */
export function unexplained({ sensor_fault: fault, suspected_fault: suspected }) {
  if (fault) return SENSOR_FAULTS[fault] ?? `sensor: ${fault.replaceAll("_", " ")}`;
  return suspected ? (SUSPECTED_FAULTS[suspected] ?? suspected.replaceAll("_", " ")) : null;
}

/** The check that has deviated for several records; empty when there is none. */
export function lastingWords({ lasting }) {
  return lasting ? `${featureName(lasting)} has deviated for several records` : "";
}

function noveltyFact({ novelty }) {
  if (!novelty) return null;
  const { p_value: probability, outside, largest_deviations: largest = [] } = novelty;
  const odd = largest
    .slice(0, 3)
    .map(
      ({ feature, deviations }) =>
        `${featureName(feature)} ${deviations > 0 ? "+" : "−"}${number(Math.abs(deviations), 2)} σ`,
    );
  const details = [
    `probability of such a record in the best state: ${number(probability, 2)}`,
    lastingWords(novelty),
    outside && odd.length ? `largest: ${odd.join(", ")}` : "",
  ];
  return fact(
    "Novelty",
    unexplained(novelty) ?? (outside ? "not explained by wear" : "explained by wear"),
    small(details.filter(Boolean).join("; ")),
  );
}

function identifiableFact({ interval_um: [low, high] }, { resolved_um: resolved }) {
  if (!resolved || resolved[1] - resolved[0] < 1)
    return fact("Uncertainty", `± ${depth((high - low) / 2)} µm`, small("half of the 90 % interval"));
  return fact(
    "Resolution",
    `${depth(resolved[0])} to ${depth(resolved[1])} µm cannot be distinguished`,
    small("within this range the library's change is smaller than its error at this operating point"),
  );
}

/** The text beside the plots of a match. */
export function matchWords(segment, match, asset, query) {
  const { wear } = segment;
  const state = wearState(wear, asset.limits);
  const overview = format({ page: "asset", id: asset.id, query: { ...query, segment: query.segment } });
  return [
    h(
      "div",
      { class: "plot-head" },
      h("h2", {}, `Record of ${clock(segment.start_time)}`),
      h("a", { href: overview }, "Open record"),
    ),
    badge(state, 26),
    h(
      "p",
      {},
      `Best library state: ${match.state_index}. ${wear.reason ? `${wear.reason[0].toUpperCase()}${wear.reason.slice(1)}.` : ""}`,
    ),
    h(
      "dl",
      { class: "facts" },
      ...wearFacts(wear).filter(Boolean),
      agreementFact(match),
      identifiableFact(match, wear),
      noveltyFact(wear),
      fact(
        "Library",
        h(
          "a",
          {
            href: format({
              page: "library",
              id: match.library_id,
              query: { state: String(match.state_index) },
            }),
          },
          match.library_id.slice(0, 8),
        ),
        small("states and their figures"),
      ),
    ),
  ];
}
