// The fleet page: all assets, sorted by severity, filtered by name and state.

import * as api from "./api.js";
import { focusedData, h, setChildren, setText } from "./dom.js";
import { firstSteps } from "./first-steps.js";
import { grouped, GroupRow, placeOf } from "./fleet-groups.js";
import { assetName, FleetRow, isBrief } from "./fleet-row.js";
import { RowWindow } from "./fleet-window.js";
import { change } from "./route.js";
import { assetState, isUsable, rank, STATES, timeToLimit } from "./state.js";
import { symbol } from "./symbols.js";

const wearOf = ({ summary: { wear } }) => (isUsable(wear) ? wear.median_um : -1);
const leftOf = ({ summary }) =>
  timeToLimit(summary.wear, summary.last_start_time)?.seconds ?? Number.MAX_VALUE;
const lastOf = (asset) => Date.parse(asset.summary.last_start_time ?? 0);
const collator = new Intl.Collator("en", { numeric: true });
const byName = (a, b) => collator.compare(assetName(a), assetName(b));

/** @type {{ key?: string, label: string, descends?: boolean, compare?: (a: any, b: any) => number }[]} */
const COLUMNS = [
  { key: "name", label: "Asset", compare: byName },
  {
    key: "state",
    label: "State",
    descends: true,
    compare: (a, b) => rank(assetState(a)) - rank(assetState(b)) || wearOf(b) - wearOf(a),
  },
  { key: "wear", label: "Wear, 90 % interval", descends: true, compare: (a, b) => wearOf(b) - wearOf(a) },
  { label: "Wear history" },
  { key: "limit", label: "Time to limit", compare: (a, b) => leftOf(a) - leftOf(b) },
  { key: "last", label: "Last record", descends: true, compare: (a, b) => lastOf(b) - lastOf(a) },
  {
    key: "segments",
    label: "Records",
    descends: true,
    compare: (a, b) => b.summary.segments - a.summary.segments,
  },
];

/** Fleets larger than this use compact rows by default. */
const MANY = 20;

/** The fleet page. */
export class FleetPage {
  #assets;
  #query;
  #rows = new Map();
  #headers = new Map();
  #body = h("tbody", { role: "rowgroup" });
  #table;
  #window;
  #total = h("p", { class: "muted", "aria-live": "polite" });
  #states = h("div", { class: "chips", role: "group", "aria-label": "Filter by state" });
  #search = h("input", {
    type: "search",
    id: "fleet-search",
    placeholder: "Name, id or location",
    autocomplete: "off",
    oninput: () => change({ q: this.#search.value }, { quiet: true }),
  });
  #grouped = h("input", {
    type: "checkbox",
    id: "fleet-grouped",
    onchange: () => change({ flat: this.#grouped.checked ? null : "1" }),
  });
  #groupField = h(
    "label",
    { class: "check", for: "fleet-grouped", hidden: true },
    this.#grouped,
    "Group by location",
  );
  #groups = new Map();
  #order = h("select", { id: "fleet-sort", onchange: () => change({ sort: this.#order.value, desc: null }) });
  #height = h(
    "select",
    { id: "fleet-rows", onchange: () => change({ rows: this.#height.value }, { quiet: true }) },
    [
      ["low", "Compact"],
      ["high", "Comfortable"],
    ].map(([value, text]) => h("option", { value }, text)),
  );
  #list = h("div", { class: "card fleet", hidden: true });
  #empty = h("div", { hidden: true });
  #loading = h("p", { class: "notice loading" }, "Loading the fleet…");

  constructor(root, route) {
    this.#query = route.query;
    for (const { key, label } of COLUMNS.filter((column) => column.key))
      this.#order.append(h("option", { value: key }, label));
    const tools = h(
      "div",
      { class: "fleet-tools" },
      h("label", { class: "field", for: "fleet-search" }, h("span", {}, "Filter"), this.#search),
      h("label", { class: "field narrow-only", for: "fleet-sort" }, h("span", {}, "Sort by"), this.#order),
      h("label", { class: "field row-height", for: "fleet-rows" }, h("span", {}, "Row height"), this.#height),
      this.#groupField,
      this.#states,
      this.#total,
    );
    const columns = h(
      "thead",
      { role: "rowgroup" },
      h(
        "tr",
        { role: "row", "aria-rowindex": "1" },
        COLUMNS.map((column) => this.#header(column)),
      ),
    );
    // Explicit roles, because the card layout on narrow screens drops the implicit ones
    this.#table = h(
      "table",
      { role: "table", "aria-label": "Assets", "aria-colcount": String(COLUMNS.length) },
      columns,
      this.#body,
    );
    this.#window = new RowWindow(
      this.#table,
      this.#body,
      (item, known) => this.#rowOf(item, known),
      (item) => `${item.members ? "group" : isBrief(item) ? "brief" : "asset"} ${this.#height.value}`,
    );
    this.#list.append(tools, this.#table);
    const head = h(
      "header",
      { class: "fleet-head" },
      h("h1", {}, "Fleet"),
      h("a", { class: "button primary", href: "#/new" }, "New asset"),
    );
    setChildren(root, head, this.#loading, this.#empty, this.#list);
    document.title = "Fleet · flankwatch";
  }

  /** @param {(typeof COLUMNS)[number]} column */
  #header({ key, label }) {
    if (!key) return h("th", { scope: "col", role: "columnheader" }, label);
    const header = h(
      "th",
      { scope: "col", role: "columnheader" },
      h("button", { type: "button", class: "sort", onclick: () => this.#sortBy(key) }, label),
    );
    this.#headers.set(key, header);
    return header;
  }

  #sortBy(key) {
    const { sort = "state", desc } = this.#query;
    change({ sort: key, desc: sort === key && !desc ? "1" : null });
  }

  /** Reacts to a changed address; nothing needs to be fetched. */
  update(route) {
    this.#query = route.query;
    this.#render();
    return false;
  }

  /** Fetches the assets and shows what changed. */
  async refresh(signal) {
    const assets = await api.assets(signal);
    if (assets === this.#assets) return;
    this.#assets = assets;
    this.#render();
  }

  /** Updates the displayed ages. */
  tick() {
    for (const item of this.#window.shown) this.#rows.get(item.id)?.tick();
  }

  /** Removes the scroll listeners. */
  dispose() {
    this.#window.dispose();
  }

  #render() {
    if (!this.#assets) return;
    const empty = this.#assets.length === 0;
    this.#loading.hidden = true;
    this.#list.hidden = empty;
    this.#empty.hidden = !empty;
    if (empty && !this.#empty.firstChild) this.#empty.append(firstSteps());
    const { q = "", state, sort = "state", desc } = this.#query;
    if (this.#search.value !== q) this.#search.value = q;
    this.#order.value = sort;
    this.#renderStates(state);
    this.#renderSort(sort, desc);
    this.#renderRows(this.#chosen(q, state, sort, desc));
  }

  #chosen(q, state, sort, desc) {
    const words = q.toLowerCase().split(/\s+/).filter(Boolean);
    const matches = (asset) =>
      words.every((word) =>
        `${asset.name} ${asset.id} ${Object.values(asset.location ?? {}).join(" ")}`
          .toLowerCase()
          .includes(word),
      );
    const { compare } = COLUMNS.find((column) => column.key === sort) ?? COLUMNS[1];
    const sign = desc ? -1 : 1;
    return this.#assets
      .filter((asset) => matches(asset) && (!state || assetState(asset) === state))
      .sort((a, b) => sign * compare(a, b) || byName(a, b));
  }

  #renderRows(assets) {
    const { rows = this.#assets.length > MANY ? "low" : "high" } = this.#query;
    this.#height.value = rows === "low" ? "low" : "high";
    this.#list.classList.toggle("low", rows === "low");
    const placed = this.#assets.some((asset) => placeOf(asset));
    this.#groupField.hidden = !placed;
    this.#grouped.checked = placed && !this.#query.flat;
    this.#window.show(this.#grouped.checked ? grouped(assets, this.#query.closed) : assets);
    const all = this.#assets.length;
    setText(
      this.#total,
      assets.length === all
        ? `${all} ${all === 1 ? "asset" : "assets"}`
        : `${assets.length} of ${all} assets`,
    );
  }

  /** The row of an asset or the heading of a group; with `known`, only an existing one. */
  #rowOf(item, known) {
    const [rows, key, make] = item.members
      ? [this.#groups, item.place, () => new GroupRow(COLUMNS.length)]
      : [this.#rows, item.id, () => new FleetRow()];
    if (known) return rows.get(key)?.element;
    if (!rows.has(key)) rows.set(key, make());
    rows.get(key).update(item);
    return rows.get(key).element;
  }

  #renderStates(chosen) {
    const counts = new Map();
    for (const asset of this.#assets) counts.set(assetState(asset), (counts.get(assetState(asset)) ?? 0) + 1);
    if (chosen && STATES[chosen] && !counts.has(chosen)) counts.set(chosen, 0);
    const signature = JSON.stringify([...counts, chosen]);
    if (this.#states.dataset.signature === signature) return;
    this.#states.dataset.signature = signature;
    const focused = this.#states.contains(document.activeElement) ? focusedData("key") : null;
    const chips = [...counts]
      .sort(([a], [b]) => rank(a) - rank(b))
      .map(([key, number]) => {
        const pressed = key === chosen;
        const onclick = () => change({ state: pressed ? null : key });
        return h(
          "button",
          { type: "button", class: "chip", "data-key": key, "aria-pressed": String(pressed), onclick },
          symbol(key, 16),
          `${STATES[key].short} ${number}`,
        );
      });
    setChildren(this.#states, chips);
    chips.find((chip) => chip.dataset.key === focused)?.focus();
  }

  #renderSort(sort, desc) {
    for (const [key, header] of this.#headers) {
      const { descends = false } = COLUMNS.find((column) => column.key === key);
      if (key === sort)
        header.setAttribute("aria-sort", descends !== Boolean(desc) ? "descending" : "ascending");
      else header.removeAttribute("aria-sort");
    }
  }
}
