// Acknowledges several alarms at once.

import * as api from "./api.js";
import { h, setText } from "./dom.js";
import { some } from "./format.js";
import { storeName, storedName } from "./person.js";

const alarms = (n) => some(n, "alarm");

/** The bar above the alarm list: acknowledges the selected alarms with one name and comment. */
export class BulkAcknowledge {
  #chosen = new Set();
  #offered = [];
  #words = h("p", { class: "muted", "aria-live": "polite" });
  #all = h("input", { type: "checkbox", id: "alarms-all", onclick: () => this.#takeAll(this.#all.checked) });
  #by = h("input", { id: "alarms-by", autocomplete: "name", maxlength: 200 });
  #comment = h("input", { id: "alarms-comment", maxlength: 2000 });
  #act = h("button", { type: "submit", class: "primary" }, "Acknowledge");
  #result = h("p", { class: "result", role: "status" });
  #fields = h(
    "div",
    { class: "bulk-fields", hidden: true },
    h("label", { class: "field", for: "alarms-by" }, h("span", {}, "Your name"), this.#by),
    h("label", { class: "field", for: "alarms-comment" }, h("span", {}, "Comment"), this.#comment),
    this.#act,
  );
  element = h(
    "form",
    { class: "alarm-bulk", hidden: true, onsubmit: (event) => this.#acknowledge(event) },
    h("label", { class: "check", for: "alarms-all" }, this.#all, "Select all"),
    this.#words,
    this.#fields,
    this.#result,
  );

  constructor() {
    this.#by.value = storedName();
  }

  /** Shows the alarms that can be selected and drops the selection of alarms no longer listed. */
  offer(ids) {
    this.#offered = ids;
    for (const id of [...this.#chosen]) if (!ids.includes(id)) this.#chosen.delete(id);
    this.element.hidden = ids.length === 0 && !this.#result.textContent;
    this.#show();
  }

  /** The checkbox in an alarm's row. */
  box(id, words) {
    const box = h("input", {
      type: "checkbox",
      class: "alarm-pick",
      "aria-label": `Select the alarm ${words}`,
      onclick: () => this.#take(id, box.checked),
    });
    box.checked = this.#chosen.has(id);
    box.dataset.pick = id;
    return box;
  }

  #take(id, checked) {
    if (checked) this.#chosen.add(id);
    else this.#chosen.delete(id);
    this.#show();
  }

  #takeAll(checked) {
    this.#chosen = new Set(checked ? this.#offered : []);
    /** @type {NodeListOf<HTMLInputElement>} */
    const boxes = document.querySelectorAll("[data-pick]");
    for (const box of boxes) box.checked = this.#chosen.has(box.dataset.pick);
    this.#show();
  }

  #show() {
    const { size } = this.#chosen;
    this.#all.checked = size > 0 && size === this.#offered.length;
    this.#all.indeterminate = size > 0 && size < this.#offered.length;
    this.#all.parentElement.hidden = this.#offered.length === 0;
    this.#fields.hidden = size === 0;
    setText(this.#words, size ? `${alarms(size)} selected` : "");
    setText(this.#act, `Acknowledge ${alarms(size)}`);
  }

  async #acknowledge(event) {
    event.preventDefault();
    const [by, comment] = [this.#by.value.trim(), this.#comment.value.trim()];
    this.#by.removeAttribute("aria-invalid");
    if (!by) {
      this.#by.setAttribute("aria-invalid", "true");
      this.#by.focus();
      return this.#showStatus("bad", "Enter your name.");
    }
    storeName(by);
    this.#act.disabled = true;
    let [done, refused, reason] = [0, 0, ""];
    try {
      for (const id of [...this.#chosen]) {
        const response = await api.settle(
          api.actOnAlarm(id, "acknowledge", { by, ...(comment && { comment }) }),
        );
        this.#chosen.delete(id);
        if (response instanceof Error) [refused, reason] = [refused + 1, response.message];
        else done += 1;
      }
      this.#comment.value = "";
      this.#showStatus(
        refused ? "part" : "good",
        `${alarms(done)} acknowledged.${refused ? ` ${alarms(refused)} failed: ${reason}.` : ""}`,
      );
    } catch (error) {
      this.#showStatus("bad", `Stopped after ${alarms(done)}: ${error.message}.`);
    } finally {
      this.#act.disabled = false;
      document.dispatchEvent(new CustomEvent("recordschange"));
    }
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }
}
