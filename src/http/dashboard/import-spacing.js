// Start times for files that have none: records taken at a fixed interval, in the order of the files' names.

import { h, setText } from "./dom.js";
import { count } from "./format.js";

const byName = new Intl.Collator("en", { numeric: true });

/** Shown when several files have only their modification time. */
export class StartSpacing {
  #cards = [];
  #words = h("p");
  #first = h("input", { type: "datetime-local", step: "1", id: "spacing-first" });
  #interval = h("input", { type: "number", min: 0, step: "any", id: "spacing-interval", value: "60" });
  #onChange;
  element = h(
    "div",
    { class: "result spacing", "data-kind": "part", hidden: true },
    this.#words,
    h(
      "div",
      { class: "fields" },
      h("label", { class: "field", for: "spacing-first" }, h("span", {}, "First record, UTC"), this.#first),
      h(
        "label",
        { class: "field", for: "spacing-interval" },
        h("span", {}, "Every, minutes"),
        this.#interval,
      ),
      h("button", { type: "button", onclick: () => this.#apply() }, "Set start times"),
    ),
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
      `${count(this.#cards.length)} files do not say when they were recorded. Wear follows the order of the records, so their times matter: set them below, in the order of the file names, or one by one.`,
    );
    this.#first.value ||= this.#cards[0].start()?.slice(0, 19) ?? "";
  }

  #apply() {
    const minutes = Number(this.#interval.value);
    if (!this.#first.value || !(minutes > 0))
      return (this.#first.value ? this.#interval : this.#first).focus();
    const begin = Date.parse(`${this.#first.value}Z`);
    for (const [n, card] of this.#cards.entries())
      card.setStart(new Date(begin + n * minutes * 60_000).toISOString(), "at the interval entered");
    this.#onChange();
  }
}
