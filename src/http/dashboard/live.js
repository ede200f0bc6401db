// Asks again when the server tells that something has changed, or every two seconds where it cannot tell;
// says how fresh the page is, and keeps trying when the connection is lost.

import { ConnectionError } from "./api.js";
import { setText } from "./dom.js";
import { Events } from "./events.js";
import { age, clock } from "./format.js";

const INTERVAL_MS = 2000;
const TOLD_INTERVAL_MS = 20_000; // where the server tells of changes, a look now and then only guards against a missed one
const LEAST_MS = 700; // between two looks, however many events there are
const RETRIES_MS = [2000, 3000, 5000, 10_000];

/** Runs `task(signal)` over and over; `report` gets `{ state, updatedAt, lostAt, retryAt, error }` after every change. */
export class Live {
  #task;
  #report;
  #timer;
  #abort = new AbortController();
  #failures = 0;
  #status = { state: "loading" };
  #told = false;
  #busy = false;
  #due = false;

  constructor(task, report) {
    this.#task = task;
    this.#report = report;
    document.addEventListener("visibilitychange", () => !document.hidden && this.now());
    addEventListener("online", () => this.now());
    new Events(
      () => this.#changed(),
      (told) => {
        this.#told = told;
        this.#changed(); // something may have happened before the stream began, or since it ended
      },
    );
  }

  /** An event: what is under way goes on, and another look follows. */
  #changed() {
    const isFirst = !this.#due;
    this.#due = true;
    // further events do not put the look off: where they come without a pause it would never be
    if (isFirst && !this.#busy && this.#failures === 0) this.#later(LEAST_MS);
  }

  /** Asks at once and forgets what is under way: what was asked for may have changed. */
  async now() {
    clearTimeout(this.#timer);
    this.#abort.abort();
    const abort = (this.#abort = new AbortController());
    this.#busy = true;
    this.#due = false;
    try {
      await this.#task(abort.signal);
      if (abort.signal.aborted) return;
      this.#busy = false;
      this.#failures = 0;
      this.#set({ state: "live", told: this.#told, updatedAt: Date.now() });
      this.#later(this.#due ? LEAST_MS : this.#told ? TOLD_INTERVAL_MS : INTERVAL_MS);
    } catch (error) {
      if (error.name === "AbortError" || abort.signal.aborted) return;
      this.#busy = false;
      this.#lost(error);
    }
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
    this.#status = status;
    this.#report(status);
  }
}

/** Shows a status in the page's header and banner; call it every second so that ages grow. */
export function showStatus(status, { live, text, banner, bannerText, bannerWait }) {
  const { state, updatedAt, lostAt, retryAt, error, told } = status;
  live.dataset.state = state;
  document.body.dataset.connection = state; // what is still loading then says nothing that the banner does not
  live.title = told
    ? "The server tells of every change at once"
    : "The page asks the server every two seconds";
  const fresh = updatedAt ? `updated ${age(new Date(updatedAt).toISOString())}` : "no data yet";
  setText(text, state === "loading" ? "connecting…" : fresh);
  const lost = state === "lost" || state === "failed";
  banner.hidden = !lost;
  if (!lost) return;
  const since = clock(lostAt).slice(11);
  const what =
    state === "lost"
      ? `Connection lost since ${since}: ${error.message}.`
      : error.status === 401
        ? "The service asks for a token."
        : `The page could not be brought up to date: ${error.message}.`;
  setText(bannerText, updatedAt ? `${what} What you see may be out of date.` : what);
  // the countdown is kept out of what a screen reader announces: it changes every second
  const wait = Math.ceil((retryAt - Date.now()) / 1000);
  setText(bannerWait, wait > 0 ? `Trying again in ${wait} s.` : "Trying again…");
}
