// Dialog for maintenance: what was done, when, and by whom.

import * as api from "./api.js";
import { h, setText } from "./dom.js";
import { clock, some } from "./format.js";
import { InspectionFields } from "./inspection-fields.js";
import { MAINTENANCE, maintenanceWord } from "./life-events.js";
import { storeName, storedName } from "./person.js";
import { instant, written, zoneName } from "./time-zone.js";

const changed = () => document.dispatchEvent(new CustomEvent("recordschange"));

const MINUTE_MS = 60_000;

const OF_GEARS = ["gear_replaced", "inspected"];

/** The dialog with the form for one maintenance event. */
export class MaintenanceDialog {
  #id;
  #title = h("h2", { id: "maintenance-title" });
  #time = h("input", {
    id: "maintenance-time",
    type: "datetime-local",
    step: 1,
    required: true,
    onchange: () => this.#countRecords(),
  });
  #by = h("input", { id: "maintenance-by", autocomplete: "name", maxlength: 200, required: true });
  #comment = h("textarea", {
    id: "maintenance-comment",
    rows: 2,
    maxlength: 2000,
    placeholder: "for example the serial number of the new pair",
  });
  #proposed = { text: "", time: "" }; // in the time field as filled, and what it stands for
  #recordTime; // of the displayed record
  #reach = h("p", { class: "muted", role: "status" });
  #inspection = new InspectionFields();
  #kinds = new Map(); // kind → its label with the radio button
  #result = h("p", { class: "result", role: "status" });
  #save = h("button", { type: "submit", class: "primary" }, "Save");
  element;

  constructor(assetId) {
    this.#id = assetId;
    Object.entries(MAINTENANCE).forEach(([kind, { word, words }], n) => {
      const label = h(
        "label",
        {},
        h("input", {
          type: "radio",
          name: "maintenance-kind",
          value: kind,
          checked: n === 0,
          onchange: () => this.#kindChanged(),
        }),
        h("strong", {}, word),
        h("span", { class: "muted" }, words),
      );
      this.#kinds.set(kind, label);
    });
    const field = (input, text) => h("label", { class: "field", for: input.id }, h("span", {}, text), input);
    const close = h(
      "button",
      { type: "button", class: "quiet", onclick: () => this.element.close() },
      "Close",
    );
    const form = h(
      "form",
      { onsubmit: (event) => this.#submit(event) },
      h("fieldset", { class: "maintenance-kinds" }, h("legend", {}, "Type"), ...this.#kinds.values()),
      this.#inspection.element,
      h("div", { class: "fields" }, field(this.#time, `Time, ${zoneName()}`), field(this.#by, "Your name")),
      field(this.#comment, "Comment"),
      h(
        "div",
        { class: "form-buttons" },
        this.#save,
        h(
          "span",
          { class: "muted" },
          "Takes effect from the first record at or after that time. An entry in the past recomputes the history.",
        ),
      ),
      this.#reach,
      this.#result,
    );
    this.element = h(
      "dialog",
      { class: "records maintenance", "aria-labelledby": "maintenance-title" },
      h("div", { class: "plot-head" }, this.#title, close),
      form,
    );
  }

  /** Shows the dialog for a displayed record; some kinds need gears. */
  open({ name, recordTime, hasGears }) {
    setText(this.#title, `Maintenance of ${name}`);
    this.#recordTime = recordTime;
    for (const kind of OF_GEARS) this.#kinds.get(kind).hidden = !hasGears;
    if (this.element.querySelector("[name=maintenance-kind]:checked").closest("label").hidden)
      this.element.querySelector("label:not([hidden]) > [name=maintenance-kind]").click();
    this.#propose();
    this.#by.value ||= storedName();
    this.#showStatus("", "");
    if (!this.element.open) this.element.showModal();
  }

  get #kind() {
    return this.element.querySelector("[name=maintenance-kind]:checked").value;
  }

  #kindChanged() {
    this.#inspection.show(this.#kind === "inspected");
    if (this.#time.value === this.#proposed.text) this.#propose();
    else this.#countRecords();
  }

  /** Fills in the time: a measurement belongs to the displayed record, any other change is after all records. */
  #propose() {
    const time = (this.#kind === "inspected" && this.#recordTime) || new Date().toISOString();
    this.#time.value = written(time).slice(0, 19);
    this.#proposed = { text: this.#time.value, time };
    this.#countRecords();
  }

  /** The entered time. As text it has no fraction of a second, and an hour of local time may occur twice. */
  #entered() {
    const { text, time } = this.#proposed;
    return this.#time.value === text ? time : instant(this.#time.value);
  }

  /** Says how many records the entry would affect. */
  async #countRecords() {
    setText(this.#reach, "");
    if (!this.#time.value) return;
    const from = this.#entered();
    const response = await api.settle(api.recordCount(this.#id, { from })).catch(() => null);
    if (!response || response instanceof Error || !this.#time.value || from !== this.#entered()) return;
    const { records } = response;
    setText(this.#reach, records ? `Affects ${some(records, "record")} at or after that time.` : "");
  }

  async #submit(event) {
    event.preventDefault();
    const kind = this.#kind;
    const inspection = kind === "inspected" ? this.#inspection.value() : undefined;
    if (inspection === null) return;
    const time = this.#entered();
    if (Date.parse(time) > Date.now() + MINUTE_MS && !confirm(`${clock(time)} is in the future. Save it?`))
      return;
    const [by, comment] = [this.#by.value.trim(), this.#comment.value.trim()];
    storeName(by);
    this.#save.disabled = true;
    try {
      await api.addMaintenance(this.#id, { time, kind, by, comment, inspection });
      this.#comment.value = "";
      this.#inspection.clear();
      this.element.close();
      changed();
    } catch (error) {
      this.#showStatus("bad", `Saving failed: ${error.message}.`);
    } finally {
      this.#save.disabled = false;
    }
  }

  /** Deletes an event after confirmation; `about` is as for `open`. */
  async takeBack(event, about) {
    if (
      !confirm(
        `Delete “${maintenanceWord(event.kind)}” of ${clock(event.time)}? The history is then recomputed without it.`,
      )
    )
      return;
    const response = await api.settle(api.deleteMaintenance(this.#id, event.id));
    if (response instanceof Error) {
      this.open(about);
      this.#showStatus("bad", `Deleting failed: ${response.message}.`);
    }
    changed();
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }

  /** Closes the dialog. */
  dispose() {
    this.element.close();
  }
}
