// The number of unacknowledged alarms, shown beside the link to the alarms in the page header.

import * as api from "./api.js";
import { setText } from "./dom.js";

const MAX_ALARMS = 1000;

/** Keeps the count of unacknowledged alarms in the navigation up to date. */
export class AlarmCount {
  #badge;
  #number;
  #shown;

  /** `badge` is hidden when there are no such alarms; `number` inside it holds the count. */
  constructor(badge, number) {
    this.#badge = badge;
    this.#number = number;
  }

  /** Fetches the count. Errors are shown by the page that needs the list. */
  async refresh(signal) {
    const response = await api.settle(
      api.alarms({ state: "unacknowledged,returned_unacknowledged", limit: MAX_ALARMS }, signal),
    );
    if (response === this.#shown || response instanceof Error) return;
    this.#shown = response;
    const { items, next_cursor: more } = response;
    this.#badge.hidden = items.length === 0;
    this.#badge.dataset.severity = items.some(({ severity }) => severity === "danger") ? "danger" : "warning";
    setText(this.#number, more ? `${MAX_ALARMS}+` : String(items.length));
  }
}
