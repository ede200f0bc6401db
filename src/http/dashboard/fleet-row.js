// One asset of the fleet: a table row on a wide screen, a card on a narrow one.

import { h, setChildren, setText } from "./dom.js";
import { age, clock, count, depth } from "./format.js";
import { baselineBar, sparkline, wearBar } from "./gauge.js";
import { statusWords } from "./record-statuses.js";
import { format } from "./route.js";
import { assetState, depthWords, limitUse, timeToLimit, transmissionWords } from "./state.js";
import { badge } from "./symbols.js";

/** The asset's name, or its id when it has none. */
export function assetName(asset) {
  return asset.name || asset.id;
}

function cell(label, ...children) {
  return h("td", { role: "cell", "data-label": label }, ...children);
}

function note(text) {
  return h("span", { class: "muted" }, text);
}

const WAITING = {
  empty: "waiting for the first record",
  no_library: "no gear pair defined",
  normal: "no gear mesh: matches the baseline",
  library_failed: "library build failed",
  building: "building the library",
};

/** Why an asset whose state is an alarm has no estimate. */
function reasonOf({ gear, summary }) {
  if (!gear) return "no gear mesh";
  if (!gear.pair) return WAITING.no_library;
  const status = summary.wear?.status;
  if (status === "outside_library") return "not explained by wear";
  return status ? statusWords(summary.wear).toLowerCase() : "no estimate";
}

function wearContent(asset, state) {
  const { wear } = asset.summary;
  if (state === "collecting") return [baselineBar(wear.baseline)];
  if (wear?.median_um == null) return [note(WAITING[state] ?? reasonOf(asset))];
  const use = limitUse(wear, asset.limits);
  const { number, interval } = depthWords(wear);
  const error = transmissionWords(wear);
  return [
    h(
      "p",
      { class: "wear-number" },
      h("strong", {}, number),
      h("span", { class: "muted" }, interval.replace("90 %: ", "")),
      use
        ? h(
            "span",
            { class: "muted use", title: `${use.name} limit` },
            `${Math.round(100 * use.share)} % of ${depth(use.limit)} µm`,
          )
        : null,
    ),
    wearBar(wear, asset.limits),
    error
      ? h(
          "span",
          { class: "muted transmission-words", title: error.interval },
          `transmission error due to wear ${error.number}`,
        )
      : null,
  ].filter(Boolean);
}

function limitContent({ wear, last_start_time: last }, limits) {
  const left = timeToLimit(wear, last);
  if (!left && limitUse(wear, limits)?.share >= 1) return [note("passed")];
  if (!left) return [note("–")];
  return [
    h("strong", {}, left.median),
    h("span", { class: "muted interval-words" }, left.interval),
    left.from === "from now" ? null : h("span", { class: "muted interval-words" }, left.from),
    h("span", { class: "spoken" }, `${depth(left.limit)} µm on ${clock(left.date)}`),
  ];
}

function alarmWords({ danger = 0, warning = 0, unacknowledged = 0, shelved = 0 } = {}) {
  const raised = danger + warning;
  const open = h("span", { class: "unacknowledged", "data-severity": danger ? "danger" : "warning" });
  open.append(String(unacknowledged), h("span", { class: "word" }, " unacknowledged"));
  const parts = [
    raised && h("span", {}, `${raised} ${raised === 1 ? "alarm" : "alarms"}`),
    unacknowledged && open,
    shelved && h("span", {}, `${shelved} shelved`),
  ].filter(Boolean);
  const comma = () => h("span", { class: "comma" }, ", ");
  const listed = parts.flatMap((part, n) => (n ? [comma(), part] : [part]));
  return parts.length ? h("span", { class: "muted alarm-words" }, listed) : null;
}

/** Whether an asset has no wear to draw over time, so that its row needs less space on a narrow screen. */
export const isBrief = ({ summary }) => !(summary.recent_wear_um?.length > 1);

/** A row that is built once and then updated. */
export class FleetRow {
  #asset;
  #age = h("span");
  #link = h("a");
  #id = h("span", { class: "muted id" });
  #state = cell("State");
  #wear = cell("Wear");
  #trend = cell("Wear history");
  #limit = cell("Time to limit");
  #last = cell("Last record", this.#age);
  #segments = cell("Records");
  element = h(
    "tr",
    { role: "row" },
    h("th", { scope: "row", role: "rowheader" }, this.#link, this.#id),
    this.#state,
    this.#wear,
    this.#trend,
    this.#limit,
    this.#last,
    this.#segments,
  );

  /** Shows an asset; nothing happens when the object is unchanged. */
  update(asset) {
    if (asset === this.#asset) return;
    this.#asset = asset;
    const { summary } = asset;
    const state = assetState(asset);
    this.element.dataset.asset = asset.id;
    this.element.dataset.state = state;
    this.element.toggleAttribute("data-brief", isBrief(asset));
    this.#link.href = format({ page: "asset", id: asset.id });
    setText(this.#link, assetName(asset));
    setText(this.#id, [asset.location?.mesh, asset.name && asset.id].filter(Boolean).join(" · "));
    setChildren(this.#state, h("div", { class: "parts" }, badge(state), alarmWords(summary.alarms)));
    setChildren(this.#wear, ...wearContent(asset, state));
    setChildren(this.#trend, isBrief(asset) ? note("–") : sparkline(summary.recent_wear_um, asset.limits));
    setChildren(this.#limit, h("div", { class: "parts" }, limitContent(summary, asset.limits)));
    setText(this.#segments, count(summary.segments));
    this.#segments.dataset.count = String(summary.segments);
    this.element.title = this.#summary(summary.last_start_time);
    this.tick();
  }

  /** What compact rows leave out; on the whole row, because its link covers the cells. */
  #summary(last) {
    const words = (cell) => [...cell.firstChild.children].map((part) => part.textContent).join(", ");
    return [
      words(this.#state),
      this.#limit.querySelector("strong") ? `Time to limit: ${words(this.#limit)}` : "",
      last ? `Last record: ${clock(last)}` : "",
    ]
      .filter(Boolean)
      .join("\n");
  }

  /** Updates the age of the last record. */
  tick() {
    setText(this.#age, age(this.#asset.summary.last_start_time));
  }
}
