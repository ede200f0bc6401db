// The stream of server-sent events.

import { address } from "./api.js";
import { readEvents } from "./server-events.js";

const AGAIN_MS = 10_000;

/**
 * Follows `/v1/events`: calls `onEvent(kind)` for each event and `onState(connected)` when the stream starts
 * and ends.
 */
export class Events {
  #onEvent;
  #onState;
  #last = null;
  #connected = false;

  constructor(onEvent, onState) {
    this.#onEvent = onEvent;
    this.#onState = onState;
    this.#subscribe();
  }

  async #subscribe() {
    for (;;) {
      try {
        await readEvents(address(["events"]), {
          headers: this.#last ? { "last-event-id": this.#last } : {},
          onOpen: () => this.#set(true),
          onEvent: (event) => this.#take(event),
        });
      } catch {
        // Lost or refused: polling continues meanwhile
      }
      this.#set(false);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  #take({ kind, id, data }) {
    if (id) this.#last = id;
    if (data !== undefined) this.#onEvent(kind);
  }

  #set(connected) {
    if (connected === this.#connected) return;
    this.#connected = connected;
    this.#onState(connected);
  }
}
