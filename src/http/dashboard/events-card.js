// Alarms and maintenance of one asset, newest first, with a button to enter maintenance.

import { changeWords, quantityWords, stateWords } from "./alarm-words.js";
import { h, svg } from "./dom.js";
import { clock } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";
import { inspectionWords } from "./inspection.js";
import { MAINTENANCE, maintenanceWord, sameEvents } from "./life-events.js";
import { format } from "./route.js";
import { symbol } from "./symbols.js";

/** One alarm; `elsewhere` marks one of another channel. */
function alarmItem(alarm, elsewhere = false) {
  const { id, quantity, severity, history, asset_id: asset, channel } = alarm;
  const latest = history.findLast(({ action, withdrawn_at: withdrawn }) => !action && !withdrawn);
  const words = latest ? `${changeWords(latest, alarm)}, ${clock(latest.time)}` : "";
  const link = h(
    "a",
    { href: format({ page: "alarms", query: { asset, show: "all", alarm: id } }) },
    quantityWords(quantity),
  );
  return h(
    "li",
    {},
    symbol(severity ?? "normal", 20),
    h("span", {}, elsewhere ? `Channel ${channel}: ` : null, link, `: ${stateWords(alarm, true)}`),
    h("span", { class: "muted" }, words),
  );
}

const wrench = () =>
  svg(
    "svg",
    { class: "wrench", viewBox: "0 0 24 24", width: 20, height: 20, "aria-hidden": "true" },
    svg("path", {
      d: "M21 6.500a5.500 5.500 0 0 1-7.300 5.200L6.400 19a2.400 2.400 0 0 1-3.400-3.400l7.300-7.300A5.500 5.500 0 0 1 17.500 3l-3.200 3.200 3.500 3.500z",
    }),
  );

/** The list of an asset's alarms and maintenance. */
export class EventsCard {
  #onRemove;
  #shown;
  #list = h("ul");
  #rows = new KeyedRows(
    this.#list,
    ({ item }) => item.id,
    ({ item, kind }) =>
      kind === "maintenance" ? this.#maintenanceItem(item) : alarmItem(item, kind === "elsewhere"),
  );
  #words = h("p", { class: "muted loading" }, "Loading…");
  element;

  /** `onAdd()` opens the maintenance dialog; `onRemove(event)` deletes an entry. */
  constructor(onAdd, onRemove) {
    this.#onRemove = onRemove;
    const tell = h("button", { type: "button", onclick: onAdd }, "Add maintenance…");
    this.element = h(
      "section",
      { class: "card events-card", "aria-label": "Alarms and maintenance" },
      h("div", { class: "plot-head" }, h("h2", {}, "Alarms and maintenance"), tell),
      this.#words,
      this.#list,
    );
  }

  /** Shows a response of `fetchEvents`. */
  show(events) {
    if (sameEvents(events, this.#shown)) return;
    this.#shown = events;
    const { maintenance, alarms, others, refused } = events;
    const entries = maintenance instanceof Error ? [] : maintenance.items;
    const trouble = refused ?? (maintenance instanceof Error ? maintenance : null);
    this.#words.textContent = trouble
      ? trouble.message
      : alarms.length + others.length + entries.length
        ? ""
        : "No alarms on this channel and no maintenance entries.";
    this.#words.hidden = !this.#words.textContent;
    this.#list.hidden = alarms.length + others.length + entries.length === 0;
    const of = (kind) => (item) => ({ kind, item });
    this.#rows.show([
      ...alarms.map(of("alarm")),
      ...others.map(of("elsewhere")),
      ...entries.map(of("maintenance")),
    ]);
  }

  #maintenanceItem(event) {
    const { time, kind, by, comment, inspection } = event;
    const details = [
      inspection && inspectionWords(inspection),
      clock(time),
      by && `entered by ${by}`,
      comment && `“${comment}”`,
    ]
      .filter(Boolean)
      .join(", ");
    const remove = h(
      "button",
      {
        type: "button",
        class: "quiet",
        "aria-label": `Delete entry: ${maintenanceWord(kind)}, ${clock(time)}`,
        onclick: () => this.#onRemove(event),
      },
      "Delete",
    );
    return h(
      "li",
      {},
      wrench(),
      h("strong", { title: MAINTENANCE[kind]?.words }, maintenanceWord(kind)),
      remove,
      h("span", { class: "muted" }, details),
    );
  }
}
