// Fetches again when the server reports a change, or every two seconds without the event stream; shows how
// recent the page is and retries after a lost connection.

import { ConnectionError } from "./api.js";
import { setText } from "./dom.js";
import { Events } from "./events.js";
import { age, clock } from "./format.js";

const INTERVAL_MS = 2000;
const PUSHED_INTERVAL_MS = 20_000; // with the event stream, polling only guards against missed events
const MIN_MS = 700; // minimum time between two updates, however many events arrive
const LATE_MS = 60_000; // a server that has not answered for that long may have stopped
const RETRIES_MS = [2000, 3000, 5000, 10_000];

/**
 * Runs `task(signal)` repeatedly; `report` receives `{ state, updatedAt, lostAt, retryAt, error }` after
 * every change.
 */
export class Live {
  #task;
  #report;
  #timer;
  #lateness;
  #abort = new AbortController();
  #failures = 0;
  #status = { state: "loading" };
  #pushed = false;
  #busy = false;
  #due = false;

  constructor(task, report) {
    this.#task = task;
    this.#report = report;
    document.addEventListener("visibilitychange", () => !document.hidden && this.now());
    addEventListener("online", () => this.now());
    new Events(
      () => this.#changed(),
      (pushed) => {
        this.#pushed = pushed;
        this.#changed(); // something may have happened before the stream started or since it ended
      },
    );
  }

  /** An event: the running update continues, and another one follows. */
  #changed() {
    const isFirst = !this.#due;
    this.#due = true;
    // Further events do not postpone the update: with continuous events it would never run
    if (isFirst && !this.#busy && this.#failures === 0) this.#later(MIN_MS);
  }

  /** Updates at once and discards the running update: what it fetched may have changed. */
  async now() {
    clearTimeout(this.#timer);
    this.#abort.abort();
    const abort = (this.#abort = new AbortController());
    this.#busy = true;
    this.#due = false;
    clearTimeout(this.#lateness);
    this.#lateness = setTimeout(() => this.#late(Date.now() - LATE_MS), LATE_MS);
    try {
      await this.#task(abort.signal);
      if (abort.signal.aborted) return;
      this.#busy = false;
      this.#failures = 0;
      this.#set({ state: "live", pushed: this.#pushed, updatedAt: Date.now() });
      this.#later(this.#due ? MIN_MS : this.#pushed ? PUSHED_INTERVAL_MS : INTERVAL_MS);
    } catch (error) {
      if (error.name === "AbortError" || abort.signal.aborted) return;
      this.#busy = false;
      this.#lost(error);
    }
  }

  /** No response so far: what is shown may be old, but the response may still come. */
  #late(since) {
    const { updatedAt, lostAt = since } = this.#status;
    const error = new ConnectionError("no answer so far");
    this.#set({ state: "lost", updatedAt, lostAt, error });
  }

  #lost(error) {
    const delay = RETRIES_MS[Math.min(this.#failures, RETRIES_MS.length - 1)];
    this.#failures += 1;
    const lostAt = this.#status.lostAt ?? Date.now();
    const state = error instanceof ConnectionError ? "lost" : "failed";
    this.#set({ state, updatedAt: this.#status.updatedAt, lostAt, retryAt: Date.now() + delay, error });
    this.#later(delay);
  }

  #later(delay) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => (document.hidden ? this.#later(delay) : this.now()), delay);
  }

  #set(status) {
    clearTimeout(this.#lateness);
    this.#status = status;
    this.#report(status);
  }
}

/** Shows the status in the page's header and banner; called every second so that ages advance. */
export function showStatus(status, { live, text, banner, bannerText, bannerWait }) {
  const { state, updatedAt, lostAt, retryAt, error, pushed } = status;
  live.dataset.state = state;
  document.body.dataset.connection = state; // loading notices are then hidden: the banner explains the state
  live.title = pushed ? "Live updates from the server" : "Polling the server every two seconds";
  const fresh = updatedAt ? `updated ${age(new Date(updatedAt).toISOString())}` : "no data yet";
  setText(text, state === "loading" ? "connecting…" : fresh);
  // The login dialog already says that a token is required.
  const lost = state === "lost" || (state === "failed" && error.status !== 401);
  banner.hidden = !lost;
  if (!lost) return;
  const since = clock(lostAt).slice(11);
  const what =
    state === "lost"
      ? `Connection lost since ${since}: ${error.message}.`
      : `Update failed: ${error.message}.`;
  setText(bannerText, updatedAt ? `${what} The data shown may be out of date.` : what);
  // The countdown is hidden from screen readers: it changes every second
  const wait = Math.ceil((retryAt - Date.now()) / 1000);
  setText(bannerWait, wait > 0 ? `Retrying in ${wait} s.` : "Retrying…");
}
