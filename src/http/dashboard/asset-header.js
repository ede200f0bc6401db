// The head of an asset's overview: state, current wear with its interval, and the facts behind them.

import { levelWords, quantityWords, reading } from "./alarm-words.js";
import { h, setChildren, setOptions, setText } from "./dom.js";
import { age, clock, depth, hertz, number, some, speedDoubt, speedSource } from "./format.js";
import { baselineBar, wearBar } from "./gauge.js";
import { AssetTabs, crumbs } from "./asset-frame.js";
import { assetName } from "./fleet-row.js";
import { statusWords } from "./record-statuses.js";
import { change, format } from "./route.js";
import {
  assetState,
  capital,
  channelState,
  depthWords,
  isUsable,
  limitUse,
  sentence,
  STATES,
  timeToLimit,
} from "./state.js";
import { badge } from "./symbols.js";

function fact(term, ...words) {
  return h("div", { class: "fact" }, h("dt", {}, term), h("dd", {}, ...words));
}

function small(text, title) {
  return h("span", { class: "muted", title }, text);
}

function speedFact(speed, nominal, known) {
  if (!speed)
    return fact(
      "Shaft speed",
      known || nominal == null ? "not found" : hertz(nominal),
      nominal == null ? null : small(known ? `nominal ${hertz(nominal)}` : "nominal"),
    );
  return fact(
    "Shaft speed",
    `${hertz(speed.shaft_speed_hz)}, ${number(speed.shaft_speed_hz * 60, 4)} rpm`,
    small(speedDoubt(speed) ?? speedSource(speed)),
  );
}

const STAGES = {
  waiting: "waiting for another simulation",
  library: "library",
  first_members: "first varied pairs",
  members: "varied pairs",
};

/** Progress of a simulation. */
const roughTime = (seconds) => (seconds < 90 ? `${Math.ceil(seconds)} s` : `${Math.ceil(seconds / 60)} min`);

function simulationWords({ stage, fraction, remaining_s: left }, estimated) {
  if (stage === "waiting") return STAGES.waiting + (estimated ? `, then about ${roughTime(estimated)}` : "");
  const time = left == null ? "" : `, ${roughTime(left)} left`;
  return `${STAGES[stage] ?? stage}: ${Math.floor(100 * fraction)} % simulated${time}`;
}

const BEST_STATE =
  "The simulated wear state nearest to this record alone. The wear depth is the median over all records since the baseline and all simulated pairs, so the two may differ.";

function libraryFact(summary, wear) {
  const { library_id: id, library_state: state, library_error: error, simulation } = summary;
  const best = wear?.best_state;
  const words = best ? `state ${best.index}, ${depth(best.wear_um)} µm` : state;
  const detail = simulation
    ? simulationWords(simulation, summary.library_estimated_s)
    : error
      ? `failed: ${error}`
      : state === "none"
        ? "no gear pair defined"
        : null;
  return fact(
    best ? "Best library state" : "Library",
    words,
    best ? small("fits this record best; the wear depth also weighs earlier records", BEST_STATE) : null,
    detail ? small(detail) : null,
    id ? small(`library ${id.slice(0, 8)}`, id) : null,
  );
}

function limitFact(wear) {
  const left = timeToLimit(wear);
  if (!left) return null;
  const words = left.from === "from now" ? left.median : `${left.median} ${left.from}`;
  return fact(
    `Time to ${depth(left.limit)} µm`,
    words,
    small(
      `90 %: ${left.interval}; ${clock(left.date, { toMinute: true })}; recent wear rate ${number(left.rate, 2)} µm/day; the forecast takes it a quarter higher`,
    ),
  );
}

function meshFacts(gear, speed) {
  return [
    fact(
      "Mesh frequency",
      hertz(speed?.mesh_frequency_hz ?? gear.shaft_speed_hz * gear.teeth[0]),
      small(speed ? "teeth × shaft speed" : "from the nominal speed"),
    ),
    fact("Gears", `${gear.teeth[0]} / ${gear.teeth[1]} teeth`, small(gear.pair?.name || "driving / driven")),
  ];
}

function bearingsFact(bearings) {
  return bearings?.length ? fact("Bearings", bearings.map(({ name }) => name).join(", ")) : null;
}

function zoneFact({ velocity_limits_mm_per_s: limits }) {
  return limits ? fact("Velocity zones A to D", `limits ${limits.join(", ")} mm/s`) : null;
}

/** Each channel's contribution to the asset's estimate. */
function channelsFact({ wear, wear_channels: parts }) {
  if (!parts) return null;
  const words = (part) => {
    if (part.silent_since) return `silent, last record ${age(part.silent_since)}`;
    const novelty = part.novelty_score == null ? "" : `, novelty ${number(part.novelty_score, 2)}`;
    return statusWords(part) + novelty;
  };
  return fact(
    "Combined channels",
    h("span", { title: wear.reason }, statusWords(wear)),
    ...parts.map((part) =>
      h("div", { class: "muted", title: part.reason }, `${part.channel}: ${words(part)}`),
    ),
  );
}

function facts(asset, wear, last) {
  const { summary, gear, shaft } = asset;
  const speed = wear?.shaft_speed;
  const { have, need } = wear?.baseline ?? {};
  const baseline =
    have >= need
      ? [`complete, ${need} records`]
      : [baselineBar({ have: have ?? 0, need: need ?? asset.baseline.records })];
  return [
    limitFact(wear),
    fact("Baseline", ...baseline),
    gear ? libraryFact(summary, wear) : null,
    speedFact(speed, gear?.shaft_speed_hz ?? shaft?.speed_hz, Boolean(wear?.segment_id)),
    ...(gear ? meshFacts(gear, speed) : []),
    bearingsFact(asset.bearings),
    channelsFact(summary),
    zoneFact(summary),
    fact("Records", some(summary.segments, "record"), last),
  ];
}

/** Everything above the plots of an asset's page. */
export class AssetHeader {
  #name = h("h1");
  #id = h("span", { class: "muted id" });
  #state = h("div", { class: "state-line" });
  #sentence = h("p", { class: "sentence" });
  #number = h("p", { class: "wear-now" });
  #bar = h("div");
  #facts = h("dl", { class: "facts" });
  #age = h("span", { class: "muted" });
  #last;
  #channel = h("select", {
    id: "channel",
    onchange: () => change({ channel: this.#channel.value, segment: null }),
  });
  #channelField = h(
    "label",
    { class: "field", for: "channel", hidden: true },
    h("span", {}, "Channel"),
    this.#channel,
  );
  #tabs;
  #verdict = h(
    "div",
    { class: "card verdict" },
    h("div", { class: "verdict-main" }, this.#state, this.#number, this.#bar, this.#sentence),
    this.#facts,
  );
  element;

  constructor(id, onAddRecords) {
    this.#tabs = new AssetTabs(id, "asset");
    const add = h("button", { type: "button", onclick: onAddRecords }, "Add records…");
    this.element = h(
      "header",
      { class: "asset-header" },
      crumbs(["#/", "Fleet"]),
      h(
        "div",
        { class: "asset-title" },
        h("div", {}, this.#name, this.#id),
        h("div", { class: "asset-actions" }, this.#channelField, add),
      ),
      this.#tabs.element,
      this.#verdict,
    );
  }

  /**
   * Shows an asset and the latest wear estimate of one channel; `events` are that channel's events, if known.
   */
  update(asset, wear, channel, query, events) {
    const { summary, limits } = asset;
    this.#tabs.update(query, asset);
    const name = assetName(asset);
    setText(this.#name, name);
    setText(this.#id, asset.name ? asset.id : "");
    const overall = assetState(asset);
    const several = summary.channels.length > 1 && wear?.segment_id;
    const state = several ? channelState(asset, wear, events?.alarms ?? []) : overall;
    setChildren(
      this.#state,
      badge(state, 30),
      several && events ? wholeAsset(asset, overall, state, channel, events.others, query) : null,
    );
    this.#verdict.dataset.severity = STATES[state].severity;
    document.title = `${STATES[overall].short} · ${name} · flankwatch`;
    const known = wear?.median_um != null;
    setChildren(this.#number, ...(known ? wearNumber(wear, limits) : []));
    this.#number.hidden = !known;
    setChildren(this.#bar, known ? wearBar(wear, limits) : null);
    const words = wear?.segment_id
      ? sentence(wear, limits, Boolean(asset.gear?.pair), Boolean(asset.gear)) + question(wear)
      : sentence(null);
    const alarms = several ? (events?.alarms ?? []) : [...(events?.alarms ?? []), ...(events?.others ?? [])];
    setChildren(
      this.#sentence,
      several ? `Channel ${channel}: ` : null,
      ...alarmSentence(state, alarms),
      words,
    );
    setChildren(this.#facts, facts(asset, wear, this.#age));
    this.#last = summary.last_start_time;
    this.#age.title = this.#last ? `${clock(summary.first_start_time)} to ${clock(this.#last)}` : "";
    this.#updateChannels(summary.channels, channel);
    this.tick();
  }

  /** Shows the last estimate when the latest record has none; `items` is the wear history. */
  recall(items, wear) {
    const last = wear.median_um == null ? items.findLast(isUsable) : null;
    if (!last) return;
    this.#number.hidden = false;
    setChildren(
      this.#number,
      h("span", {}, `Last estimate ${depth(last.median_um)} µm`),
      h(
        "span",
        { class: "muted" },
        `90 %: ${depth(last.low_um)} to ${depth(last.high_um)} µm, ${clock(last.start_time)}`,
      ),
    );
  }

  #updateChannels(channels, chosen) {
    this.#channelField.hidden = channels.length < 2;
    setOptions(
      this.#channel,
      channels.map((name) => [name, name]),
    );
    this.#channel.value = chosen ?? "";
  }

  /** Updates the age of the last record. */
  tick() {
    setText(this.#age, this.#last ? `latest ${age(this.#last)}` : "none yet");
  }
}

/** The raised alarm that determines a state, with a link to it; empty for other states. */
function alarmSentence(state, alarms) {
  const alarm = alarms.find((one) => one.state !== "shelved" && state === `alarm_${one.severity}`);
  if (!alarm) return [];
  const { id, asset_id: asset, quantity, value } = alarm;
  const cause = [`${STATES[state].word}: ${quantityWords(quantity)}`];
  if (quantity !== "sensor_fault") cause.push(` ${reading(value, alarm)}, ${levelWords(alarm)}`);
  const href = format({ page: "alarms", query: { asset, show: "all", alarm: id } });
  return [h("a", { href }, ...cause), ". "];
}

/** In the first records, the doubt about teeth and speed, where the status does not say it already. */
function question({ status, shaft_speed: speed }) {
  const first = ["collecting_baseline", "awaiting_library"].includes(status);
  const doubt = first && speed ? speedDoubt(speed) : null;
  return doubt ? ` The speed is ${doubt}` : "";
}

/** The state of the whole asset, when another channel makes it differ from the displayed channel's state. */
function wholeAsset({ id, summary }, overall, state, channel, others, query) {
  if (overall === state) return null;
  const alarmed = others.find(({ severity }) => overall === `alarm_${severity}`)?.channel;
  const speaker = alarmed ?? summary.wear_channel;
  const link =
    speaker && speaker !== channel
      ? h(
          "a",
          { href: format({ page: "asset", id, query: { ...query, channel: speaker, segment: null } }) },
          `channel ${speaker}`,
        )
      : null;
  return h(
    "p",
    { class: "whole-asset" },
    h("span", { class: "muted" }, "Asset:"),
    badge(overall, 18),
    link && h("span", { class: "muted" }, "due to ", link),
  );
}

function wearNumber(wear, limits) {
  const use = limitUse(wear, limits);
  const { number: depthNumber, interval } = depthWords(wear);
  const [value, um] = depthNumber.split(/ (?=µm$)/);
  const share = use ? ` · ${Math.round(100 * use.share)} % of the ${use.name} limit` : "";
  return [
    h("strong", {}, capital(value), um ? h("span", {}, ` ${um}`) : null),
    h("span", { class: "muted" }, `${interval}${share}`),
  ];
}
