// The list of alarms, filtered by state, with history and actions of the selected one.

import { BulkAcknowledge } from "./alarm-bulk.js";
import { AlarmDetail } from "./alarm-detail.js";
import { NotificationList } from "./alarm-notifications.js";
import { fetchUnits, unitOf } from "./alarm-units.js";
import {
  ALARM_STATES,
  levelWords,
  quantityWords,
  reading,
  severityBadge,
  stateWords,
} from "./alarm-words.js";
import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { age, clock } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";
import { change, format, parse } from "./route.js";

const LIMIT = 200;

const FILTERS = [
  ["", "To do", "unacknowledged,returned_unacknowledged"],
  ["raised", "Acknowledged", "acknowledged"],
  ["shelved", "Shelved", "shelved"],
  ["all", "All", undefined],
];

/** The alarms of the whole fleet, or of one asset. */
export class AlarmsPage {
  #query;
  #shown;
  #asked = "";
  #chips = new Map();
  #total = h("p", { class: "muted", "aria-live": "polite" });
  #asset = h("button", {
    type: "button",
    class: "chip",
    "aria-pressed": "true",
    hidden: true,
    onclick: () => change({ asset: null }),
  });
  #body = h("tbody");
  #table = h(
    "table",
    { class: "alarms", hidden: true },
    h(
      "thead",
      {},
      h(
        "tr",
        {},
        ["Severity", "Asset", "Quantity", "Reading", "Since", "State"].map((text) =>
          h("th", { scope: "col" }, text),
        ),
      ),
    ),
    this.#body,
  );
  #notice = h("p", { class: "notice" }, "Loading the alarms…");
  #detail = new AlarmDetail();
  #notifications = new NotificationList();
  #bulk = new BulkAcknowledge();
  #rows = new KeyedRows(
    this.#body,
    ({ id }) => id,
    (alarm) => this.#row(alarm),
  );
  #ages = new Map();

  constructor(root, route) {
    this.#query = route.query;
    const chips = h("div", { class: "chips", role: "group", "aria-label": "Filter alarms by state" });
    for (const [key, label] of FILTERS) {
      const chip = h(
        "button",
        { type: "button", class: "chip", onclick: () => change({ show: key || null }) },
        label,
      );
      this.#chips.set(key, chip);
      chips.append(chip);
    }
    chips.append(this.#asset);
    const list = h(
      "section",
      { class: "card table-card", "aria-label": "List of alarms" },
      h("div", { class: "fleet-tools" }, chips, this.#total),
      this.#bulk.element,
      this.#table,
      this.#notice,
    );
    setChildren(
      root,
      h("h1", {}, "Alarms"),
      h("div", { class: "alarm-grid" }, list, this.#detail.element),
      this.#notifications.element,
    );
    document.title = "Alarms · flankwatch";
  }

  /** Reacts to a changed address. */
  update(route) {
    this.#query = route.query;
    return true;
  }

  /** Fetches the alarms and shows what changed. */
  async refresh(signal) {
    const { show = "", asset, alarm } = this.#query;
    const [, , state] = FILTERS.find(([key]) => key === show) ?? FILTERS[0];
    const [answer] = await Promise.all([
      api.answer(api.alarms({ state, asset, limit: LIMIT }, signal)),
      this.#detail.show(alarm, signal),
      this.#notifications.refresh(signal),
    ]);
    const asked = JSON.stringify([show, asset, alarm]);
    if (answer === this.#shown && asked === this.#asked) return;
    if (!(answer instanceof Error)) await fetchUnits(answer.items, signal);
    [this.#shown, this.#asked] = [answer, asked];
    for (const [key, chip] of this.#chips) chip.setAttribute("aria-pressed", String(key === show));
    this.#asset.hidden = !asset;
    setText(this.#asset, `Only ${asset} ✕`);
    this.#asset.setAttribute("aria-label", `Only ${asset}; show all assets`);
    this.#render(answer, show);
  }

  #render(answer, show) {
    const items = answer instanceof Error ? [] : answer.items;
    this.#table.hidden = items.length === 0;
    this.#notice.hidden = items.length > 0;
    if (answer instanceof Error) setText(this.#notice, answer.message);
    else
      setText(
        this.#notice,
        show === ""
          ? "Nothing to do: all alarms are acknowledged."
          : show === "all"
            ? "No alarm has been raised yet."
            : "No alarms in this state.",
      );
    setText(
      this.#total,
      answer instanceof Error
        ? ""
        : `${answer.next_cursor ? `the latest ${LIMIT}` : items.length} ${items.length === 1 ? "alarm" : "alarms"}`,
    );
    this.#bulk.offer(items.filter(({ state }) => ALARM_STATES[state]?.open).map(({ id }) => id));
    const shown = new Set(items.map(({ id }) => id));
    for (const id of this.#ages.keys()) if (!shown.has(id)) this.#ages.delete(id);
    const { query } = parse(location.hash);
    this.#rows.show(items, (alarm) => JSON.stringify([alarm, unitOf(alarm), query]));
  }

  #row(alarm) {
    const {
      id,
      asset_id: asset,
      channel,
      quantity,
      severity,
      value,
      state,
      raised_at: raised,
      changed_at: changed,
    } = alarm;
    const since = h("span", { title: clock(raised ?? changed) });
    this.#ages.set(id, [since, raised ?? changed]);
    const { query } = parse(location.hash);
    const open = h(
      "a",
      { class: "alarm-open", href: format({ page: "alarms", query: { ...query, alarm: id } }) },
      quantityWords(quantity),
    );
    const { open: todo, words } = ALARM_STATES[state] ?? {};
    const row = h(
      "tr",
      { "data-alarm": id, "data-state": state, "aria-current": this.#query.alarm === id ? "true" : null },
      h(
        "td",
        { "data-label": "Severity" },
        h(
          "span",
          { class: "alarm-severity" },
          todo ? this.#bulk.box(id, `${quantityWords(quantity)} of ${asset}, channel ${channel}`) : null,
          severityBadge(severity),
        ),
      ),
      h(
        "th",
        { scope: "row" },
        h("a", { href: format({ page: "asset", id: asset, query: { channel } }) }, asset),
        h("span", { class: "muted id" }, channel),
      ),
      h("td", { "data-label": "Quantity" }, open, h("span", { class: "muted id" }, levelWords(alarm))),
      h("td", { "data-label": "Reading" }, reading(value, alarm)),
      h("td", { "data-label": "Since" }, since),
      h(
        "td",
        { "data-label": "State" },
        h("span", { class: todo ? "alarm-todo" : "", title: words }, stateWords(alarm)),
      ),
    );
    setText(since, age(raised ?? changed));
    return row;
  }

  /** Updates the displayed ages. */
  tick() {
    for (const [element, time] of this.#ages.values()) setText(element, age(time));
    this.#notifications.tick();
  }
}
