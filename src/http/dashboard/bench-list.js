// The records on the bench as a list with colour, asset, channel, time and actions, and a form to add more.

import * as api from "./api.js";
import { formatRecords, MAX_RECORDS, recordsOf } from "./bench-records.js";
import { h, setChildren, setText } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { clock, number, unit } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";
import { legend } from "./plots.js";
import { recordWords } from "./record-facts.js";
import { change, format, parse } from "./route.js";

const OFFERED = 1000; // newest records offered, the most that the server returns at once

const option = (value, text) => h("option", { value }, text);

/** The list of records; calls `onListen(id)` to play one. */
export class BenchList {
  #onListen;
  #list = h("ul", { class: "bench-records" });
  #rows = new KeyedRows(
    this.#list,
    ({ id }) => id,
    (record) => this.#row(record),
  );
  #none = h(
    "p",
    { class: "notice" },
    "No records on the bench yet. Add one below, or click “Compare…” on a record's page.",
  );
  #asset = h("select", { id: "bench-asset", onchange: () => this.#offerRecords() }, option("", "Choose…"));
  #channel = h("select", { id: "bench-channel", onchange: () => this.#offerRecords(this.#channel.value) });
  #record = h("select", { id: "bench-record" });
  #add = h("button", { type: "submit", class: "primary", disabled: true }, "Add");
  #clear = h(
    "button",
    { type: "button", class: "quiet", hidden: true, onclick: () => change({ records: null }) },
    "Remove all",
  );
  #result = h("p", { class: "result", role: "status" });
  #offered;
  element;

  constructor(onListen) {
    this.#onListen = onListen;
    const field = (input, text) => h("label", { class: "field", for: input.id }, h("span", {}, text), input);
    for (const select of [this.#channel, this.#record]) select.disabled = true;
    const form = h(
      "form",
      { class: "bench-add", onsubmit: (event) => this.#addRecord(event) },
      field(this.#asset, "Asset"),
      field(this.#channel, "Channel"),
      field(this.#record, "Record"),
      this.#add,
      this.#clear,
    );
    this.element = h(
      "section",
      { class: "card bench-list", "aria-label": "Records on the bench" },
      this.#none,
      this.#list,
      form,
      this.#result,
    );
  }

  /** Shows a status message. */
  showNotice(words, kind = "bad") {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }

  /** Offers the assets whose records can be added. */
  offerAssets(assets) {
    if (assets === this.#offered) return;
    this.#offered = assets;
    const chosen = this.#asset.value;
    setChildren(
      this.#asset,
      option("", "Choose…"),
      assets.map((asset) => option(asset.id, assetName(asset))),
    );
    this.#asset.value = chosen;
  }

  async #offerRecords(channel = "") {
    const id = this.#asset.value;
    for (const control of [this.#channel, this.#record, this.#add]) control.disabled = true;
    if (!id) return;
    try {
      const asset = this.#offered.find((each) => each.id === id);
      const { channels } = asset.summary;
      setChildren(
        this.#channel,
        option("", "All"),
        channels.map((name) => option(name, name)),
      );
      this.#channel.value = channel;
      this.#channel.disabled = false;
      const { items } = await api.recordsPage(id, { channel, limit: OFFERED, order: "desc" });
      if (this.#asset.value !== id || this.#channel.value !== channel) return; // the selection has changed in the meantime
      setChildren(
        this.#record,
        items.map((record) => {
          const { rms } = record.indicators ?? {};
          const strength = rms == null ? "" : `, RMS ${number(rms, 3)} ${unit(record.unit)}`;
          return option(record.id, `${clock(record.start_time)} · ${record.channel}${strength}`);
        }),
      );
      this.#record.disabled = this.#add.disabled = items.length === 0;
      this.showNotice(items.length ? "" : "This asset has no records.");
    } catch (error) {
      this.showNotice(`Failed to list the records of “${id}”: ${error.message}.`);
    }
  }

  #addRecord(event) {
    event.preventDefault();
    const ids = recordsOf(parse(location.hash).query);
    if (ids.includes(this.#record.value)) return this.showNotice("This record is already on the bench.");
    if (ids.length >= MAX_RECORDS)
      return this.showNotice(`The bench is full with ${MAX_RECORDS} records: remove one first.`);
    this.showNotice("");
    change({ records: formatRecords([...ids, this.#record.value]) });
  }

  #take(id) {
    const ids = recordsOf(parse(location.hash).query).filter((other) => other !== id);
    change({ records: formatRecords(ids) });
  }

  #makeFirst(id) {
    const ids = recordsOf(parse(location.hash).query).filter((other) => other !== id);
    change({ records: formatRecords([id, ...ids]) });
  }

  /**
   * Shows the records, each `{ id, segment, asset, colour, name }`; those without a segment are still
   * loading. `heard` is the record being played.
   */
  show(records, heard) {
    this.#none.hidden = records.length > 0;
    this.#clear.hidden = records.length < 2;
    this.#rows.show(
      records.map(({ id, segment, colour, name }, place) => ({
        id,
        colour,
        name,
        segment: segment instanceof Error ? null : segment,
        fault: segment instanceof Error ? segment.message : null,
        isFirst: place === 0,
        isHeard: id === heard,
      })),
    );
  }

  #row({ id, segment, fault, colour, name, isFirst, isHeard }) {
    const button = (text, what, onclick, pressed) =>
      h(
        "button",
        {
          type: "button",
          class: "quiet",
          "aria-label": `${what}: ${name}`,
          "aria-pressed": pressed,
          onclick,
        },
        text,
      );
    const swatch = legend([["line", colour, ""]])[0].firstChild;
    return h(
      "li",
      { "data-record": id },
      swatch,
      h(
        "div",
        { class: "bench-record" },
        !segment
          ? h("strong", {}, name)
          : h(
              "a",
              {
                href: format({
                  page: "asset",
                  id: segment.asset_id,
                  query: { channel: segment.channel, segment: id },
                }),
              },
              name,
            ),
        h(
          "span",
          { class: "muted" },
          segment ? recordWords(segment) : (fault ?? "Loading…"),
          isFirst ? ". Reference for the others." : "",
        ),
      ),
      h(
        "div",
        { class: "bench-buttons" },
        !segment
          ? null
          : button(
              isHeard ? "Stop" : "Listen",
              isHeard ? "Stop" : "Listen to",
              () => this.#onListen(id),
              String(isHeard),
            ),
        isFirst ? null : button("Make first", "Make first", () => this.#makeFirst(id)),
        button("Remove", "Remove", () => this.#take(id)),
      ),
    );
  }
}
