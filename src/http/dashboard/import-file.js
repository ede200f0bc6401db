// One file of the import panel: its contents, start time, and channel names.

import { h, setText } from "./dom.js";
import { bytes, clock, count, hertz, recordLength } from "./format.js";
import { ImportChannels } from "./import-channels.js";
import { preview } from "./import-preview.js";
import { instant, written, zoneName } from "./time-zone.js";
import { hasIntegers, hasVolts, recordsAt } from "./import-sending.js";

/** The facts of a preview in one line. */
function factWords({ form, rate, seconds, isEstimate, rateFrom, channels, summary, note }) {
  const topics = summary
    ? `${count(summary.messages)} messages on ${summary.topics.length} ${summary.topics.length === 1 ? "topic" : "topics"}`
    : null;
  const parts = [
    form,
    channels.length ? `${channels.length} ${channels.length === 1 ? "channel" : "channels"}` : null,
    topics,
    rate ? `${hertz(rate)}${rateFrom ? ` (${rateFrom})` : ""}` : null,
    seconds != null ? `${isEstimate ? "about " : ""}${recordLength(seconds)}` : null,
    note,
  ];
  return parts.filter(Boolean).join(" · ");
}

/**
 * The card of a file. `common()` returns the values for all files; `onRemove` is called when the file is
 * removed, `onChange` when its start times or channels change.
 */
export class ImportFile {
  file;
  seen = null;
  #asset;
  #common;
  #typed = false;
  #entered = null; // start as an ISO time, once typed or set
  #looks = 0;
  #roles;
  #channels;
  #start;
  #startLabel = h("span");
  #startWords = h("span", { class: "muted" });
  #scale = h("input", { type: "number", min: 0, step: "any", placeholder: "as above" });
  #scaleField = h(
    "label",
    {
      class: "field file-scale",
      title: "The amplitude of the largest integer in the unit, for example 50 for ±50 m/s²",
    },
    h("span", {}, "Full scale, in the unit"),
    this.#scale,
  );
  #facts = h("span", { class: "file-facts muted" }, "Inspecting the file…");
  #fault = h("p", { class: "result", "data-kind": "bad", hidden: true });
  #columns = h("div", { class: "file-columns", hidden: true });
  #collision = h("p", { class: "result", "data-kind": "part", hidden: true });
  #twins = h("p", { class: "result", "data-kind": "part", hidden: true });
  #onChange;
  #time = h("div", { class: "file-start" });
  #when = h("span", { class: "file-when muted" }); // of the folded card
  #details;
  element;

  constructor(file, asset, common, onRemove, onChange) {
    [this.file, this.#asset, this.#common, this.#onChange] = [file, asset, common, onChange];
    this.#channels = new ImportChannels(file, onChange);
    const remove = h(
      "button",
      {
        type: "button",
        class: "quiet",
        "aria-label": `Remove ${file.name}`,
        onclick: () => onRemove(this),
      },
      "✕",
    );
    this.#details = h(
      "details",
      { open: true },
      h(
        "summary",
        { class: "file-name" },
        h("strong", {}, file.name),
        h("span", { class: "muted" }, ` ${bytes(file.size)} `),
        this.#facts,
        this.#when,
      ),
      h(
        "div",
        { class: "file-body" },
        this.#fault,
        this.#time,
        this.#columns,
        this.#channels.element,
        this.#collision,
        this.#twins,
      ),
    );
    this.element = h("li", {}, this.#details, remove);
  }

  /** Collapses the card to one line, unless something needs attention. */
  fold() {
    const notes = [this.#fault, this.#collision, ...(this.hasGuessedStart ? [] : [this.#twins])];
    this.#details.open = !this.seen?.type || notes.some(({ hidden }) => !hidden);
  }

  #showWhen() {
    const start = this.start() ?? this.seen?.ownStart;
    setText(this.#when, start ? ` · ${clock(start)}` : "");
  }

  /** Inspects the file. Only the latest inspection counts, whichever response arrives last. */
  async look() {
    const turn = ++this.#looks;
    const seen = await preview(this.file, this.#common().rate, this.#roles);
    if (turn !== this.#looks) return;
    this.seen = seen;
    setText(this.#facts, seen.type ? factWords(seen) : "unsupported");
    this.#fault.hidden = !seen.fault;
    setText(
      this.#fault,
      seen.fault ? `${seen.fault[0].toUpperCase()}${seen.fault.slice(1).replace(/\.$/, "")}.` : "",
    );
    this.#showStart();
    this.#showColumns();
    this.#channels.show(seen);
    this.#showScale();
    this.#showWhen();
    this.#onChange();
    await this.#lookForCollision();
  }

  #showStart() {
    const { type, start, summary, ownStart, words } = this.seen;
    if (!type) return;
    if (!this.#start && start) {
      this.#start = h("input", {
        type: "datetime-local",
        step: "0.001",
        onchange: () => this.#typeStart(),
      });
      this.#label();
      this.#time.append(h("label", { class: "field" }, this.#startLabel, this.#start), this.#startWords);
    }
    if (start && !this.#typed) {
      this.#start.value = written(start.time);
      setText(this.#startWords, start.source);
    }
    if (start) return;
    const span = summary?.start
      ? `, logged ${clock(summary.start)} to ${clock(summary.end)}`
      : ownStart
        ? `: ${clock(ownStart)}`
        : "";
    setText(this.#startWords, `start times in the file${span}${words ? `; ${words}` : ""}`);
    this.#time.append(this.#startWords);
  }

  /** Whether the file is inspected, and supported by its name. */
  get isRecording() {
    return Boolean(this.seen?.type);
  }

  /** Whether the file itself can be read, whatever is missing beside it. */
  get isReadable() {
    const { channels, fault, lacksRate } = this.seen ?? { channels: [] };
    return this.isRecording && (channels.length > 0 || !fault || lacksRate);
  }

  /** Whether the start is the modification time of the file, which a copy may have changed. */
  get hasGuessedStart() {
    return Boolean(this.seen?.start?.isGuess) && !this.#typed;
  }

  /** Sets the start; `words` name its source. */
  setStart(time, words) {
    this.#start.value = written(time);
    this.#typeStart(time);
    setText(this.#startWords, words);
  }

  /** Whether the samples need a unit that the file does not contain. */
  get lacksUnit() {
    return this.#channels.lackUnit;
  }

  /** Whether the samples of a channel would have only the unit for all files, or none. */
  get lacksEnteredUnit() {
    return this.#channels.lackEnteredUnit;
  }

  /** Which of the values for all files this one does not use, as words. */
  unused({ fullScale, sensitivity }) {
    return [
      fullScale && !hasIntegers(this.seen) && "full scale, which is for WAV and FLAC files of integers",
      sensitivity &&
        !hasVolts(this.seen) &&
        "sensitivity, which is for WAV, FLAC, CSV, MATLAB and NumPy files",
    ].filter(Boolean);
  }

  /** Shows the times in another time zone. */
  changeZone() {
    this.#label();
    if (this.#entered) this.#start.value = written(this.#entered);
    else if (this.#start && !this.#typed) this.#start.value = written(this.seen.start.time);
    if (this.seen) this.#showStart();
    this.#showWhen();
  }

  #label() {
    setText(this.#startLabel, `Start, ${zoneName()}`);
    this.#start?.setAttribute("aria-label", `Start of ${this.file.name}, ${zoneName()}`);
  }

  #typeStart(time = this.#start.value ? instant(this.#start.value) : null) {
    this.#typed = true;
    this.#entered = time;
    const isAhead = Date.parse(time) > Date.now();
    setText(this.#startWords, isAhead ? "entered; it is in the future" : "entered");
    this.#showWhen();
    this.#onChange();
    this.#lookForCollision();
  }

  /** For CSV files: the role of each column. */
  #showColumns() {
    const { columns, roles } = this.seen;
    this.#columns.hidden = !columns?.length;
    if (!columns?.length || this.#columns.children.length) return;
    const selects = columns.map((name, place) => {
      const select = h(
        "select",
        { "aria-label": `Column ${name} of ${this.file.name}`, onchange: () => this.#takeRoles(selects) },
        [
          ["channel", "channel"],
          ["time", "time"],
          ["left_out", "ignored"],
        ].map(([value, text]) => h("option", { value }, text)),
      );
      select.value = roles[place];
      return select;
    });
    this.#columns.append(
      ...selects.map((select, place) =>
        h("label", { class: "field" }, h("span", {}, `“${columns[place]}” is`), select),
      ),
    );
  }

  #takeRoles(selects) {
    this.#roles = selects.map(({ value }) => value);
    this.#channels.clear();
    this.look();
  }

  /** For files of integers: the field of their full scale. */
  #showScale() {
    this.#scale.setAttribute("aria-label", `Full scale of ${this.file.name}`);
    if (hasIntegers(this.seen) && !this.#scaleField.isConnected) this.#time.append(this.#scaleField);
  }

  /** The start times that are known: those of the file, or the first record of each of its channels. */
  #starts() {
    const { ownStart, channels } = this.seen;
    const own = [this.start() ?? ownStart, ...channels.map(({ start }) => start)];
    return [...new Set(own.filter(Boolean).map((start) => new Date(start).toISOString()))];
  }

  /** Warns when there already is a record with the same start. */
  async #lookForCollision() {
    const starts = this.#starts();
    this.#collision.hidden = true;
    const there = (
      await Promise.all(starts.map((start) => recordsAt(this.#asset, start).catch(() => [])))
    ).flat();
    if (there.length === 0 || String(starts) !== String(this.#starts())) return;
    const channels = [...new Set(there.map(({ channel }) => channel))].join(", ");
    const which = this.seen.type === "application/mcap" ? "the start of its first record" : "this start";
    this.#collision.hidden = false;
    setText(
      this.#collision,
      `A record with ${which} already exists on channel ${channels}. Identical samples are detected as a repeat; different ones are stored as well.`,
    );
  }

  /** The known starts and channels of the file's records, each as one text. */
  places() {
    if (!this.seen?.type) return [];
    const own = this.start() ?? this.seen.ownStart;
    const names = this.#channels.names();
    return this.seen.channels.flatMap(({ start }, n) => {
      const time = own ?? start;
      return time ? [`${new Date(time).toISOString()} ${names[n]}`] : [];
    });
  }

  /** Warns that other files of the same import have the same start and channel. */
  showTwins(names) {
    this.#twins.hidden = names.length === 0;
    setText(
      this.#twins,
      names.length
        ? `Same start and channel as ${names.join(", ")} in this import. Identical samples are detected as a repeat; different ones are stored as well.`
        : "",
    );
  }

  /** The start as an ISO time; null when the file contains it or the field is empty. */
  start() {
    if (!this.#start) return null;
    // A time column may be finer than the field
    return this.#typed ? this.#entered : this.seen.start.time;
  }

  /** The number field of the file, if it contains something else; undefined otherwise. */
  get broken() {
    return this.#scale.validity.badInput ? this.#scale : undefined;
  }

  /** The values entered for the file. */
  entry() {
    return {
      start: this.start(),
      channels: this.#channels.entries(),
      fullScale: Number(this.#scale.value) || null,
      roles: this.#roles,
      isTyped: this.#typed,
    };
  }
}
