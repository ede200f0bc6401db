// Asks again every two seconds, says how fresh the page is, and keeps trying when the connection is lost.

import { ConnectionError } from "./api.js";
import { setText } from "./dom.js";
import { age } from "./format.js";

const INTERVAL_MS = 2000;
const RETRIES_MS = [2000, 3000, 5000, 10_000];

/** Runs `task(signal)` over and over; `report` gets `{ state, updatedAt, lostAt, retryAt, error }` after every change. */
export class Live {
  #task;
  #report;
  #timer;
  #abort = new AbortController();
  #failures = 0;
  #status = { state: "loading" };

  constructor(task, report) {
    this.#task = task;
    this.#report = report;
    document.addEventListener("visibilitychange", () => !document.hidden && this.now());
    addEventListener("online", () => this.now());
  }

  /** Asks at once and forgets what is under way: what was asked for may have changed. */
  async now() {
    clearTimeout(this.#timer);
    this.#abort.abort();
    const abort = (this.#abort = new AbortController());
    try {
      await this.#task(abort.signal);
      if (abort.signal.aborted) return;
      this.#failures = 0;
      this.#set({ state: "live", updatedAt: Date.now() });
      this.#later(INTERVAL_MS);
    } catch (error) {
      if (error.name === "AbortError" || abort.signal.aborted) return;
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
    this.#timer = setTimeout(() => (document.hidden ? this.#later(delay) : this.now()), delay);
  }

  #set(status) {
    this.#status = status;
    this.#report(status);
  }
}

/** Shows a status in the page's header and banner; call it every second so that ages grow. */
export function showStatus(status, { live, text, banner, bannerText, bannerWait }) {
  const { state, updatedAt, lostAt, retryAt, error } = status;
  live.dataset.state = state;
  const fresh = updatedAt ? `updated ${age(new Date(updatedAt).toISOString())}` : "no data yet";
  setText(text, state === "loading" ? "connecting…" : fresh);
  const lost = state === "lost" || state === "failed";
  banner.hidden = !lost;
  if (!lost) return;
  const since = `${new Date(lostAt).toISOString().slice(11, 19)} UTC`;
  const what = state === "lost" ? `Connection lost since ${since}: ${error.message}.` : `The page could not be brought up to date: ${error.message}.`;
  setText(bannerText, updatedAt ? `${what} What you see may be out of date.` : what);
  // the countdown is kept out of what a screen reader announces: it changes every second
  const wait = Math.ceil((retryAt - Date.now()) / 1000);
  setText(bannerWait, wait > 0 ? `Trying again in ${wait} s.` : "Trying again…");
}
