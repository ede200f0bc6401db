// Recipients of alarm notifications, with the number of waiting and failed notifications.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { age, clock } from "./format.js";

const several = (count) => `${count} ${count === 1 ? "notification" : "notifications"}`;

/** One line per recipient; hidden when there are no recipients. */
export class NotificationList {
  element = h("section", { class: "card alarm-recipients", "aria-label": "Notifications", hidden: true });
  #shown;
  #ages = [];

  /** Fetches the recipients and shows what changed. */
  async refresh(signal) {
    const response = await api.settle(api.notifications(signal));
    if (response === this.#shown || response instanceof Error) return;
    this.#shown = response;
    this.#ages = [];
    this.element.hidden = response.items.length === 0;
    const rows = response.items.map((recipient) => this.#row(recipient));
    setChildren(this.element, h("h2", {}, "Notifications"), h("ul", {}, rows));
  }

  /** @param {Answer<"/v1/notifications">["items"][number]} recipient */
  #row({ name, waiting, oldest_at: oldest, sent, last_sent_at: last, given_up: given, error }) {
    const parts = [];
    if (waiting > 0) parts.push([`${several(waiting)} waiting, the oldest from `, oldest]);
    if (given > 0) parts.push([`${several(given)} failed in 30 days`]);
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

  /** Updates the displayed ages. */
  tick() {
    for (const [element, time] of this.#ages) setText(element, age(time));
  }
}
