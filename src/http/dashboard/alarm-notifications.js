// Whom the settings have notified of alarms, and what could not be sent to them.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { age, clock } from "./format.js";

const several = (count) => `${count} ${count === 1 ? "notification" : "notifications"}`;

/** One line for each recipient; nothing where nobody is notified. */
export class NotificationList {
  element = h("section", { class: "card alarm-recipients", "aria-label": "Notifications", hidden: true });
  #shown;
  #ages = [];

  /** Asks the server and shows what changed. */
  async refresh(signal) {
    const answer = await api.answer(api.notifications(signal));
    if (answer === this.#shown || answer instanceof Error) return;
    this.#shown = answer;
    this.#ages = [];
    this.element.hidden = answer.items.length === 0;
    const rows = answer.items.map((recipient) => this.#row(recipient));
    setChildren(this.element, h("h2", {}, "Notifications"), h("ul", {}, rows));
  }

  /** @param {Answer<"/v1/notifications">["items"][number]} recipient */
  #row({ name, waiting, oldest_at: oldest, sent, last_sent_at: last, given_up: given, error }) {
    const parts = [];
    if (waiting > 0) parts.push([`${several(waiting)} waiting, the oldest noted `, oldest]);
    if (given > 0) parts.push([`${several(given)} given up in 30 days`]);
    if (sent > 0) parts.push(["last sent ", last]);
    if (parts.length === 0) parts.push(["nothing sent in 30 days"]);
    const isFailing = (waiting > 0 && error) || given > 0;
    return h(
      "li",
      { class: isFailing ? "alarm-todo" : "" },
      h("span", { class: "id" }, name),
      parts.map(([words, time]) => h("span", {}, words, time ? this.#age(time) : null)),
      error ? h("span", { class: "muted" }, error) : null,
    );
  }

  #age(time) {
    const element = h("span", { title: clock(time) }, age(time));
    this.#ages.push([element, time]);
    return element;
  }

  /** Lets ages grow. */
  tick() {
    for (const [element, time] of this.#ages) setText(element, age(time));
  }
}
