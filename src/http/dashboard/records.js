// The records of an asset as a table with filters, pages, selection and actions.

import * as api from "./api.js";
import { FramedPage } from "./asset-frame.js";
import { h, setChildren, setOptions, setText, tableHead } from "./dom.js";
import { count, some } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";
import { STATUSES } from "./record-statuses.js";
import { RecordActions } from "./records-actions.js";
import { HEADINGS, recordRow } from "./records-row.js";
import { change } from "./route.js";
import { instant, written, zoneName } from "./time-zone.js";

const PAGE = 100;

const typed = (time) => (isNaN(Date.parse(time)) ? "" : written(time).slice(0, 19));
const meant = (text) => (text ? instant(text) : null);

/** The table of one asset's records. */
export class RecordsPage extends FramedPage {
  #shown;
  #known;
  #asked;
  #items = [];
  #total = 0;
  #places = new Map(); // address of a page → its number of pages before, and the cursor of the last of them
  #selected = new Map(); // id → record, across pages
  #all = false;
  #last = null; // the record clicked last, for selection with Shift
  #channel = h("select", {
    id: "records-channel",
    onchange: () => this.#filter({ channel: this.#channel.value }),
  });
  #status = h(
    "select",
    { id: "records-status", onchange: () => this.#filter({ status: this.#status.value }) },
    h("option", { value: "" }, "All"),
    Object.entries(STATUSES).map(([key, [word]]) => h("option", { value: key }, word)),
  );
  #from = h("input", {
    id: "records-from",
    type: "datetime-local",
    step: 1,
    onchange: () => this.#filter({ from: meant(this.#from.value) }),
  });
  #to = h("input", {
    id: "records-to",
    type: "datetime-local",
    step: 1,
    onchange: () => this.#filter({ to: meant(this.#to.value) }),
  });
  #order = h(
    "select",
    { id: "records-order", onchange: () => this.#filter({ order: this.#order.value }) },
    h("option", { value: "" }, "Newest first"),
    h("option", { value: "asc" }, "Oldest first"),
  );
  #export = h("a", { class: "button", download: "" }, "Export as MCAP");
  #page = h("input", {
    type: "checkbox",
    "aria-label": "Select all records on this page",
    onclick: () => this.#pickPage(this.#page.checked),
  });
  #body = h("tbody");
  #rows = new KeyedRows(
    this.#body,
    ({ id }) => id,
    (record) => recordRow(record, (checked, shift) => this.#pick(record.id, checked, shift)),
  );
  #table = h(
    "table",
    { class: "record-table", hidden: true },
    tableHead([h("td", { class: "pick" }, this.#page), ...HEADINGS]),
    this.#body,
  );
  #notice = h("p", { class: "notice" }, "Loading records…");
  #words = h("p", { class: "muted", "aria-live": "polite" });
  #back = h("button", { type: "button", onclick: () => this.#turnBack() }, "← Previous page");
  #next = h("button", { type: "button", onclick: () => this.#turn() }, "Next page →");
  #pickAll = h("button", { type: "button", class: "quiet", hidden: true, onclick: () => this.#takeAll() });
  #actions = new RecordActions(
    this.id,
    () => this.#selection(),
    (gone) => this.#changed(gone),
  );

  constructor(root, route) {
    super(root, route, "records");
    const field = (input, text) => h("label", { class: "field", for: input.id }, h("span", {}, text), input);
    const filters = h(
      "div",
      { class: "record-filters" },
      field(this.#channel, "Channel"),
      field(this.#status, "Status"),
      field(this.#from, `From, ${zoneName()}`),
      field(this.#to, `Before, ${zoneName()}`),
      field(this.#order, "Order"),
      this.#export,
    );
    const pages = h(
      "div",
      { class: "form-buttons record-pages" },
      this.#words,
      this.#pickAll,
      this.#back,
      this.#next,
    );
    const card = h(
      "section",
      { class: "card table-card", "aria-label": "Records" },
      h("div", { class: "record-tools" }, filters, this.#actions.element, pages),
      this.#table,
      this.#notice,
    );
    setChildren(root, this.head.element, card);
    this.#actions.show(0);
  }

  /** A changed filter starts at its first page and clears the selection. */
  #filter(parameters) {
    this.#clear();
    change({ ...parameters, cursor: null });
  }

  /** Fetches again after an action; deleted records are deselected. */
  #changed(gone) {
    if (gone) {
      this.#clear();
      this.#mark();
    }
    document.dispatchEvent(new CustomEvent("recordschange"));
  }

  #turn() {
    const { cursor } = this.query;
    // The page after the displayed one is already requested
    if (this.#asked !== this.#address(cursor)) return;
    const { next_cursor: next } = this.#shown;
    this.#places.set(this.#address(next), { before: this.#place(cursor).before + 1, back: cursor });
    change({ cursor: next });
  }

  #turnBack() {
    change({ cursor: this.#place(this.query.cursor).back ?? null });
  }

  /** The page at a cursor of the current listing. */
  #address(cursor) {
    return JSON.stringify([this.#parameters(), this.query.order, cursor]);
  }

  /** How many pages are before a page; a link to a later page does not know. */
  #place(cursor) {
    return this.#places.get(this.#address(cursor)) ?? { before: cursor ? NaN : 0 };
  }

  #parameters() {
    const { channel, status, from, to } = this.query;
    return { channel, status, from, to };
  }

  /** Fetches the records and shows what changed. */
  async refresh(signal) {
    const parameters = this.#parameters();
    const { order = "desc", cursor } = this.query;
    const [asset, known, page] = await Promise.all([
      this.loadAsset(signal),
      api.settle(api.recordCount(this.id, parameters, signal)),
      api.settle(api.recordsPage(this.id, { ...parameters, order, cursor, limit: PAGE }, signal)),
    ]);
    if (!asset) return;
    const asked = this.#address(cursor);
    // Further records may change only the count
    if (page === this.#shown && known === this.#known && asked === this.#asked) return;
    [this.#shown, this.#known, this.#asked] = [page, known, asked];
    this.#fillFilters(asset.summary.channels);
    if (page instanceof Error || known instanceof Error)
      return this.#refuse(page instanceof Error ? page : known);
    this.#total = known.records;
    this.#items = page.items;
    this.#render();
  }

  #fillFilters(channels) {
    const { channel = "", status = "", from, to, order = "" } = this.query;
    setOptions(this.#channel, [["", "All"], ...channels.map((name) => [name, name])]);
    this.#channel.value = channel;
    this.#status.value = status;
    this.#order.value = order === "desc" ? "" : order;
    for (const [input, time] of [
      [this.#from, from],
      [this.#to, to],
    ])
      if (document.activeElement !== input) input.value = typed(time); // it would erase a time that is half typed
    this.#export.href = api.address(["assets", this.id, "export"], this.#parameters());
  }

  #refuse(error) {
    [this.#items, this.#total] = [[], 0];
    this.#render();
    setText(this.#notice, error.message);
  }

  #render() {
    const { cursor } = this.query;
    const { before } = this.#place(cursor);
    const first = before * PAGE + 1;
    const range = this.#items.length
      ? before >= 0
        ? `${count(first)} to ${count(first + this.#items.length - 1)} of `
        : `${count(this.#items.length)} of `
      : "";
    setText(this.#words, `${range}${some(this.#total, "record")}`);
    this.#back.disabled = !cursor;
    const isLinked = cursor && !this.#places.has(this.#address(cursor));
    setText(this.#back, isLinked ? "← First page" : "← Previous page");
    this.#next.disabled = !this.#shown?.next_cursor;
    this.#table.hidden = this.#items.length === 0;
    this.#notice.hidden = this.#items.length > 0;
    setText(
      this.#notice,
      Object.values(this.#parameters()).some(Boolean) ? "No records match these filters." : "No records yet.",
    );
    this.#rows.show(this.#items);
    this.#mark();
  }

  #pick(id, checked, shift) {
    if (this.#all) this.#clear();
    const placeOf = (record) => this.#items.findIndex((item) => item.id === record);
    const place = placeOf(id);
    const last = shift ? placeOf(this.#last) : -1;
    const [low, high] = last < 0 ? [place, place] : [Math.min(last, place), Math.max(last, place)];
    for (const record of this.#items.slice(low, high + 1)) {
      if (checked) this.#selected.set(record.id, record);
      else this.#selected.delete(record.id);
    }
    this.#last = id;
    this.#mark();
  }

  #pickPage(checked) {
    this.#all = false;
    for (const record of this.#items) {
      if (checked) this.#selected.set(record.id, record);
      else this.#selected.delete(record.id);
    }
    this.#mark();
  }

  #takeAll() {
    const all = !this.#all;
    this.#clear();
    this.#all = all;
    this.#mark();
  }

  #clear() {
    this.#selected.clear();
    [this.#all, this.#last] = [false, null];
  }

  #selection() {
    if (this.#all) return { all: this.#parameters(), count: this.#total, ids: [], records: [] };
    return { ids: [...this.#selected.keys()], records: [...this.#selected.values()] };
  }

  #mark() {
    for (const row of this.#body.rows)
      row.querySelector("input").checked = this.#all || this.#selected.has(row.dataset.record);
    this.#showSelection();
  }

  #showSelection() {
    const here = this.#items.filter(({ id }) => this.#all || this.#selected.has(id)).length;
    this.#page.checked = here > 0 && here === this.#items.length;
    this.#page.indeterminate = here > 0 && here < this.#items.length;
    this.#pickAll.hidden = this.#total <= this.#items.length;
    setText(this.#pickAll, this.#all ? "Select none" : `Select all ${count(this.#total)}`);
    this.#actions.show(this.#all ? this.#total : this.#selected.size);
  }
}
