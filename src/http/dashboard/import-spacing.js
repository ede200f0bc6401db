// Start times for files that have none: records taken at a fixed interval, in the order of the files' names.

import { h, setText } from "./dom.js";
import { clock, count } from "./format.js";
import { instant, written, zoneName } from "./time-zone.js";

const MINUTE = 60_000; // ms
const FEW = 3; // files
const byName = new Intl.Collator("en", { numeric: true });

/** Shown when several files have only their modification time. */
export class StartSpacing {
  #cards = [];
  #words = h("p");
  #first = h("input", {
    type: "datetime-local",
    step: "1",
    id: "spacing-first",
    onchange: () => {
      this.#isTyped = this.#first.value !== "";
      this.#begin = this.#isTyped ? Date.parse(instant(this.#first.value)) : NaN;
      this.#showLast();
    },
  });
  #interval = h("input", {
    type: "number",
    min: 0,
    step: "any",
    id: "spacing-interval",
    value: "60",
    onchange: () => this.#showLast(),
  });
  #last = h("p", { role: "status" });
  #isTyped = false;
  #begin = NaN; // of the first record, in ms
  #label = h("span", {}, `First record, ${zoneName()}`);
  #onChange;
  element = h(
    "div",
    { class: "result spacing", "data-kind": "part", hidden: true },
    this.#words,
    h(
      "div",
      { class: "fields" },
      h("label", { class: "field", for: "spacing-first" }, this.#label, this.#first),
      h(
        "label",
        { class: "field", for: "spacing-interval" },
        h("span", {}, "Interval, minutes"),
        this.#interval,
      ),
      h("button", { type: "button", onclick: () => this.#apply() }, "Set start times"),
    ),
    this.#last,
  );

  constructor(onChange) {
    this.#onChange = onChange;
  }

  /** Offers times for those of the files whose start is their modification time. */
  show(cards) {
    this.#cards = cards
      .filter((card) => card.hasGuessedStart)
      .sort((a, b) => byName.compare(a.file.name, b.file.name));
    this.element.hidden = this.#cards.length < 2;
    if (this.element.hidden) return;
    setText(
      this.#words,
      `${count(this.#cards.length)} files have no recording time. Wear follows the order of the records, so their times matter: set them below, in the order of the file names, or one by one.`,
    );
    this.#showLast();
  }

  /**
   * A question when files without times would all start at the same time, as after a copy; null otherwise.
   */
  question() {
    const starts = this.#cards.filter((card) => card.hasGuessedStart).map((card) => Date.parse(card.start()));
    if (starts.length < FEW || Math.max(...starts) - Math.min(...starts) > MINUTE) return null;
    return `${count(starts.length)} files have no recording time, and were all written within one minute. Wear follows the order of the records, so set their start times first. Upload them with the files' modification times anyway?`;
  }

  /** The start of the last record, in ms; NaN while something is missing. */
  get #end() {
    const minutes = Number(this.#interval.value);
    return minutes > 0 ? this.#begin + (this.#cards.length - 1) * minutes * MINUTE : NaN;
  }

  /** Shows the last start. Until a first one is entered, the last is that of the latest file. */
  #showLast() {
    if (!this.#isTyped && this.#cards.length) {
      const latest = Math.max(...this.#cards.map(({ file }) => file.lastModified));
      const span = (this.#cards.length - 1) * Number(this.#interval.value) * MINUTE;
      this.#begin = 1000 * Math.floor((latest - span) / 1000);
      this.#showFirst();
    }
    const end = this.#end;
    const words = isNaN(end) ? "" : `Last record: ${clock(new Date(end).toISOString())}`;
    setText(this.#last, words && `${words}${end > Date.now() ? ", which is in the future" : ""}.`);
  }

  #showFirst() {
    this.#first.value = isNaN(this.#begin) ? "" : written(this.#begin).slice(0, 19);
  }

  /** Shows the times in another time zone. */
  changeZone() {
    setText(this.#label, `First record, ${zoneName()}`);
    this.#showFirst();
    this.#showLast();
  }

  #apply() {
    if (isNaN(this.#end)) return (this.#first.value ? this.#interval : this.#first).focus();
    const begin = this.#begin;
    const minutes = Number(this.#interval.value);
    for (const [n, card] of this.#cards.entries())
      card.setStart(new Date(begin + n * minutes * MINUTE).toISOString(), "at the interval entered");
    this.#onChange();
  }
}
