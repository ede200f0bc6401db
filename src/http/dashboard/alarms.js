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
import { h, setChildren, setText, tableHead } from "./dom.js";
import { age, clock } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";
import { change, format, parse } from "./route.js";

const LIMIT = 200;
const BELOW = "(max-width: 68rem)"; // where the details are not beside the list, as in alarms.css

/** Position in the list: danger first. */
const rankOf = ({ severity }) => ["danger", "warning", null].indexOf(severity ?? null);

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
    tableHead(["Severity", "Asset", "Quantity", "At last change", "Since", "State"]),
    this.#body,
  );
  #notice = h("p", { class: "notice" }, "Loading the alarms…");
  #names = new Map(); // of assets, by their ids
  #detail = new AlarmDetail((id) => this.#names.get(id) || id);
  #isChosen = false; // whether an alarm was chosen whose details are not shown yet
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
    this.#isChosen ||= route.query.alarm !== this.#query.alarm;
    this.#query = route.query;
    return true;
  }

  /** Fetches the alarms and shows what changed. */
  async refresh(signal) {
    const { show = "", asset, alarm } = this.#query;
    const [, , state] = FILTERS.find(([key]) => key === show) ?? FILTERS[0];
    const [response] = await Promise.all([
      api.settle(api.alarms({ state, asset, limit: LIMIT }, signal)),
      this.#notifications.refresh(signal),
    ]);
    if (!(response instanceof Error)) await this.#fetchNames(response.items, signal);
    await this.#detail.show(alarm, signal);
    if (this.#isChosen && alarm && matchMedia(BELOW).matches) this.#detail.focus();
    this.#isChosen = false;
    const asked = JSON.stringify([show, asset, alarm]);
    if (response === this.#shown && asked === this.#asked) return;
    if (!(response instanceof Error)) await fetchUnits(response.items, signal);
    [this.#shown, this.#asked] = [response, asked];
    for (const [key, chip] of this.#chips) chip.setAttribute("aria-pressed", String(key === show));
    this.#asset.hidden = !asset;
    const name = this.#names.get(asset) || asset;
    setText(this.#asset, `Only ${name} ✕`);
    this.#asset.setAttribute("aria-label", `Only ${name}; show all assets`);
    this.#render(response, show);
  }

  /** Fetches the names of assets when one is listed for the first time. */
  async #fetchNames(alarms, signal) {
    const unknown = alarms.filter(({ asset_id: id }) => !this.#names.has(id));
    if (unknown.length === 0) return;
    const assets = await api.settle(api.assets(signal));
    for (const { id, name } of assets instanceof Error ? [] : assets) this.#names.set(id, name);
    for (const { asset_id: id } of unknown) if (!this.#names.has(id)) this.#names.set(id, "");
  }

  #render(response, show) {
    const items = response instanceof Error ? [] : response.items.toSorted((a, b) => rankOf(a) - rankOf(b));
    this.#table.hidden = items.length === 0;
    this.#notice.hidden = items.length > 0;
    if (response instanceof Error) setText(this.#notice, response.message);
    else
      setText(
        this.#notice,
        show === ""
          ? "Nothing to do: no unacknowledged alarms."
          : show === "all"
            ? "No alarm has been raised yet."
            : "No alarms in this state.",
      );
    setText(
      this.#total,
      response instanceof Error
        ? ""
        : `${response.next_cursor ? `the latest ${LIMIT}` : items.length} ${items.length === 1 ? "alarm" : "alarms"}`,
    );
    this.#bulk.offer(items.filter(({ state }) => ALARM_STATES[state]?.open).map(({ id }) => id));
    const shown = new Set(items.map(({ id }) => id));
    for (const id of this.#ages.keys()) if (!shown.has(id)) this.#ages.delete(id);
    const { query } = parse(location.hash);
    const nameOf = ({ asset_id: id }) => this.#names.get(id);
    this.#rows.show(items, (alarm) => JSON.stringify([alarm, nameOf(alarm), unitOf(alarm), query]));
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
    const name = this.#names.get(asset);
    const row = h(
      "tr",
      { "data-alarm": id, "data-state": state, "aria-current": this.#query.alarm === id ? "true" : null },
      h(
        "td",
        { "data-label": "Severity" },
        h(
          "span",
          { class: "alarm-severity" },
          todo
            ? this.#bulk.box(id, `${quantityWords(quantity)} of ${name || asset}, channel ${channel}`)
            : null,
          severityBadge(severity),
        ),
      ),
      h(
        "th",
        { scope: "row" },
        h("a", { href: format({ page: "asset", id: asset, query: { channel } }) }, name || asset),
        h("span", { class: "muted id" }, `${name ? `${asset} · ` : ""}channel ${channel}`),
      ),
      h("td", { "data-label": "Quantity" }, open, h("span", { class: "muted id" }, levelWords(alarm))),
      h("td", { "data-label": "At last change" }, reading(value, alarm)),
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
