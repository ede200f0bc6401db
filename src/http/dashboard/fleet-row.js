// One asset of the fleet: a row of the table on a wide screen, a card on a narrow one.

import { h, setChildren, setText } from "./dom.js";
import { age, clock, count, depth } from "./format.js";
import { baselineBar, sparkline, wearBar } from "./gauge.js";
import { format } from "./route.js";
import { assetState, depthWords, limitUse, timeToLimit, transmissionWords } from "./state.js";
import { badge } from "./symbols.js";

/** The name for people, or the id where there is none. */
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
  no_library: "no gear pair described",
  normal: "no gear mesh: like the baseline",
  library_failed: "the library could not be built",
  building: "the library is being built",
};

function wearContent(asset, state) {
  const { wear } = asset.summary;
  if (state === "collecting") return [baselineBar(wear.baseline)];
  if (wear?.median_um == null) return [note(WAITING[state] ?? "no estimate")];
  const use = limitUse(wear, asset.limits);
  const { number, interval } = depthWords(wear);
  const error = transmissionWords(wear);
  return [
    h(
      "p",
      { class: "wear-number" },
      h("strong", {}, state === "unclear" ? "unclear" : number),
      h("span", { class: "muted" }, interval.replace("5 to 95 %: ", "")),
      use && state !== "unclear"
        ? h(
            "span",
            { class: "muted use", title: `${use.name} limit` },
            `${Math.round(100 * use.share)} % of ${depth(use.limit)} µm`,
          )
        : null,
    ),
    wearBar(wear, asset.limits),
    error && state !== "unclear"
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
  const title = `${depth(left.limit)} µm is expected at ${clock(left.date)}`;
  return [
    h("strong", { title }, left.median),
    h("span", { class: "muted interval-words" }, left.interval),
    left.from === "from now" ? null : h("span", { class: "muted interval-words" }, left.from),
  ];
}

function alarmWords({ danger = 0, warning = 0, unacknowledged = 0, shelved = 0 } = {}) {
  const raised = danger + warning;
  const parts = [
    raised && `${raised} ${raised === 1 ? "alarm" : "alarms"}`,
    unacknowledged && `${unacknowledged} unacknowledged`,
    shelved && `${shelved} shelved`,
  ].filter(Boolean);
  return parts.length ? h("span", { class: "muted alarm-words" }, parts.join(", ")) : null;
}

/** A row that is built once and then kept up to date. */
export class FleetRow {
  #asset;
  #age = h("span");
  #link = h("a");
  #id = h("span", { class: "muted id" });
  #state = cell("State");
  #wear = cell("Wear");
  #trend = cell("Wear over the life");
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

  /** Shows an asset; the same object again costs nothing. */
  update(asset) {
    if (asset === this.#asset) return;
    this.#asset = asset;
    const { summary } = asset;
    const state = assetState(asset);
    this.element.dataset.asset = asset.id;
    this.element.dataset.state = state;
    this.#link.href = format({ page: "asset", id: asset.id });
    setText(this.#link, assetName(asset));
    setText(this.#id, [asset.location?.mesh, asset.name && asset.id].filter(Boolean).join(" · "));
    setChildren(this.#state, badge(state), alarmWords(summary.alarms));
    setChildren(this.#wear, ...wearContent(asset, state));
    setChildren(
      this.#trend,
      summary.recent_wear_um?.length > 1 ? sparkline(summary.recent_wear_um, asset.limits) : note("–"),
    );
    setChildren(this.#limit, ...limitContent(summary, asset.limits));
    setText(this.#segments, count(summary.segments));
    // a low row has no room for long words
    this.#state.title = [...this.#state.children].map((part) => part.textContent).join(", ");
    this.#last.title = summary.last_start_time ? clock(summary.last_start_time) : "";
    this.tick();
  }

  /** Lets the last record's age grow. */
  tick() {
    setText(this.#age, age(this.#asset.summary.last_start_time));
  }
}
