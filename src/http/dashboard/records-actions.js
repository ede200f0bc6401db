// Bulk actions on records: exclude, include, delete, and use as baseline.

import * as api from "./api.js";
import { compareOnBench, MAX_RECORDS } from "./bench-records.js";
import { h, setText } from "./dom.js";
import { clock, some } from "./format.js";
import { storeName, storedName } from "./person.js";

const IDS_PER_REQUEST = 200; // ids in one request
const PAGE = 1000;
const MIN_BASELINE = 8;

const records = (n) => some(n, "record");

/** The next millisecond after a time: an exclusive end that includes the record at that time. */
const after = (time) => new Date(Date.parse(time) + 1).toISOString();

/**
 * The toolbar below the filters. `selection()` returns `{ ids, records }`, or `{ all, count }` when all
 * matching records are selected; `onDone(gone)` is called after each action, with true if the selected
 * records may be gone.
 */
export class RecordActions {
  #id;
  #selection;
  #onDone;
  #words = h("p", { class: "muted", "aria-live": "polite" });
  #buttons;
  #by = h("input", { id: "records-by", autocomplete: "name", maxlength: 200 });
  #baseline = h("form", {
    class: "records-baseline",
    hidden: true,
    onsubmit: (event) => this.#takeBaseline(event),
  });
  #baselineWords = h("p");
  #stretch; // the records that the open form asks about
  #result = h("p", { class: "result", role: "status" });
  element;

  constructor(assetId, selection, onDone) {
    [this.#id, this.#selection, this.#onDone] = [assetId, selection, onDone];
    const button = (text, onclick) => h("button", { type: "button", onclick }, text);
    this.#buttons = [
      button("Compare…", () => this.#compare()),
      button("Exclude", () => this.#mark("exclude")),
      button("Include", () => this.#mark("include")),
      button("Use as baseline…", () => this.#offerBaseline()),
      button("Delete…", () => this.#delete()),
    ];
    this.#baseline.append(
      this.#baselineWords,
      h(
        "div",
        { class: "form-buttons" },
        h("label", { class: "field", for: "records-by" }, h("span", {}, "Your name"), this.#by),
        h("button", { type: "submit", class: "primary" }, "Use as baseline"),
        h(
          "button",
          { type: "button", class: "quiet", onclick: () => (this.#baseline.hidden = true) },
          "Cancel",
        ),
      ),
    );
    this.element = h(
      "div",
      { class: "records-actions" },
      h("div", { class: "form-buttons" }, this.#words, ...this.#buttons),
      this.#baseline,
      this.#result,
    );
  }

  /** Shows the number of selected records. */
  show(selected) {
    setText(this.#words, selected ? `${records(selected)} selected` : "Select records to change them.");
    for (const button of this.#buttons) button.disabled = selected === 0;
    if (selected === 0) this.#baseline.hidden = true;
  }

  /** Opens the selected records on the bench. */
  async #compare() {
    try {
      const { ids, all, count: matching } = this.#selection();
      if (matching > MAX_RECORDS)
        return this.#showStatus("bad", `${records(matching)} match; at most ${MAX_RECORDS} can be compared.`);
      this.#showStatus("bad", compareOnBench(all ? await this.#identifiers(all) : ids));
    } catch (error) {
      this.#showStatus("bad", `Action failed: ${error.message}.`);
    }
  }

  /** The number of selected records, and request parameters for them: lists of ids, or one range. */
  async #targets() {
    const { ids, all } = this.#selection();
    if (!all || all.status) {
      const chosen = all ? await this.#identifiers(all) : ids;
      return { found: chosen.length, parts: chunks(chosen).map((part) => ({ ids: part.join(",") })) };
    }
    const { channel, from, to } = all;
    const known = await api.recordCount(this.#id, { channel, from, to });
    if (!known.records) return { found: 0, parts: [] };
    // A fixed end, so that records arriving meanwhile are not affected
    const range = { channel, from: known.first_start_time, to: after(known.last_start_time) };
    return { found: known.records, parts: [range] };
  }

  async #identifiers(parameters) {
    const found = [];
    let cursor;
    do {
      const page = await api.recordsPage(this.#id, { ...parameters, limit: PAGE, cursor });
      found.push(...page.items.map(({ id }) => id));
      cursor = page.next_cursor;
    } while (cursor);
    return found;
  }

  /**
   * Acts on the selected records if `agree(found)`; returns the number changed, or null.
   * @param {(target: object) => Promise<number>} act
   * @param {{ gone?: boolean, agree?: (found: number) => boolean }} [options]
   */
  async #each(act, { gone = false, agree = () => true } = {}) {
    this.#showStatus("", "Working…");
    let done = 0;
    try {
      const { found, parts } = await this.#targets();
      if (!agree(found)) {
        this.#showStatus("", "");
        return null;
      }
      try {
        for (const target of parts) done += await act(target);
      } finally {
        this.#onDone(gone);
      }
      return done;
    } catch (error) {
      this.#showStatus("bad", `Action failed${done ? ` after ${records(done)}` : ""}: ${error.message}.`);
      return null;
    }
  }

  async #mark(action) {
    const done = await this.#each(
      async (target) => (await api.markRecords(this.#id, action, target)).changed,
    );
    if (done === null) return;
    const words = action === "exclude" ? "excluded" : "included";
    this.#showStatus(
      "good",
      done
        ? `${records(done)} ${words}. The history is being recomputed.`
        : `Nothing changed: the records were already ${words}.`,
    );
  }

  async #delete() {
    const { all } = this.#selection();
    const agree = (found) =>
      confirm(
        `Delete ${all ? `all ${records(found)} that match` : records(found)}? The history is then recomputed without ${found === 1 ? "it. Its raw recording is" : "them. Their raw recordings are"} moved to quarantine.`,
      );
    const done = await this.#each(async (target) => (await api.deleteRecords(this.#id, target)).deleted, {
      gone: true,
      agree,
    });
    if (done !== null) this.#showStatus("good", `${records(done)} deleted.`);
  }

  /** The time range from the first to the last selected record. */
  async #range() {
    const { records: selected, all } = this.#selection();
    if (all) {
      const known = await api.recordCount(this.#id, all);
      return {
        time: known.first_start_time,
        until: after(known.last_start_time),
        channels: all.channel ? [all.channel] : [undefined],
      };
    }
    const times = selected
      .map(({ start_time: start }) => start)
      .sort((a, b) => Date.parse(a) - Date.parse(b));
    return {
      time: times[0],
      until: after(times.at(-1)),
      channels: [...new Set(selected.map(({ channel }) => channel))],
    };
  }

  async #offerBaseline() {
    try {
      const { time, until, channels } = await this.#range();
      const counts = await Promise.all(
        channels.map((channel) => api.recordCount(this.#id, { channel, from: time, to: until })),
      );
      const within = counts.reduce((sum, { records: n }) => sum + n, 0);
      const few =
        Math.min(...counts.map(({ records: n }) => n)) < MIN_BASELINE
          ? ` A chosen baseline needs at least ${MIN_BASELINE} records per channel; with fewer, the baseline is collected as usual.`
          : "";
      setText(
        this.#baselineWords,
        `The ${records(within)} from ${clock(time)} to ${clock(until)} become the healthy baseline of every channel, except excluded ones. The previous baseline is discarded, and wear restarts at zero there.${few}`,
      );
      this.#stretch = { time, until };
      this.#by.value ||= storedName();
      this.#baseline.hidden = false;
      this.#by.focus();
    } catch (error) {
      this.#showStatus("bad", `Action failed: ${error.message}.`);
    }
  }

  async #takeBaseline(event) {
    event.preventDefault();
    const by = this.#by.value.trim();
    this.#by.toggleAttribute("aria-invalid", false);
    if (!by) {
      this.#by.setAttribute("aria-invalid", "true");
      this.#by.focus();
      return this.#showStatus("bad", "Enter your name.");
    }
    storeName(by);
    try {
      await api.addMaintenance(this.#id, { ...this.#stretch, kind: "baseline_chosen", by, comment: "" });
      this.#baseline.hidden = true;
      this.#showStatus(
        "good",
        "Baseline set. The history is being recomputed. To undo this, delete the entry under “Alarms and maintenance”.",
      );
      this.#onDone(false);
    } catch (error) {
      this.#showStatus("bad", `Action failed: ${error.message}.`);
    }
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }
}

function chunks(ids) {
  return Array.from({ length: Math.ceil(ids.length / IDS_PER_REQUEST) }, (_, n) =>
    ids.slice(n * IDS_PER_REQUEST, (n + 1) * IDS_PER_REQUEST),
  );
}
