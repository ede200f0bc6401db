// The live view of a stream, fetched while the page is visible; a page in the background is sent nothing.

import { address, ApiError } from "./api.js";
import { readEvents } from "./server-events.js";

const AGAIN_MS = 1500;

/**
 * Follows a stream until it is closed: calls `onFrame(frame)` for each frame, and `onState({ state, seconds?,
 * error? })` with "live", "waiting", "lost" or "refused".
 */
export class StreamFeed {
  #href;
  #onFrame;
  #onState;
  #abort = null;
  #closed = false;
  #again;
  #visible = () => (document.hidden ? this.#abort?.abort() : this.#subscribe());

  constructor(id, name, onFrame, onState) {
    this.#href = address(["assets", id, "stream", "live"], { name });
    this.#onFrame = onFrame;
    this.#onState = onState;
    document.addEventListener("visibilitychange", this.#visible);
    this.#subscribe();
  }

  async #subscribe() {
    clearTimeout(this.#again);
    this.#abort?.abort();
    if (this.#closed || document.hidden) return;
    const abort = (this.#abort = new AbortController());
    let lost = { state: "lost" };
    try {
      await readEvents(this.#href, { signal: abort.signal, onEvent: (event) => this.#take(event, abort) });
    } catch (error) {
      if (error instanceof ApiError) lost = { state: "refused", error };
    }
    if (this.#abort !== abort || abort.signal.aborted) return;
    this.#onState(lost);
    this.#again = setTimeout(() => this.#subscribe(), AGAIN_MS);
  }

  #take({ kind, data }, abort) {
    if (abort.signal.aborted) return;
    const message = JSON.parse(data);
    if (kind === "frame") this.#onFrame(message);
    if (kind === "waiting") this.#onState({ state: "waiting", seconds: message.seconds });
  }

  /** Closes the stream. */
  close() {
    this.#closed = true;
    clearTimeout(this.#again);
    document.removeEventListener("visibilitychange", this.#visible);
    this.#abort?.abort();
  }
}
