// The change of spectral lines since the baseline, computed by the server for the lines that a table shows.

import * as api from "./api.js";
import { decibels } from "./format.js";

const LINES_PER_REQUEST = 64; // lines in one request
const KEPT = 2000; // changes remembered

const place = (x) => Number(x.toPrecision(8));

/** A change in dB, or a mark that it is not known yet. */
export const levelWords = (level) => (level === undefined ? "…" : decibels(level));

/** Looks up changes; `onAnswer` is called when further ones are known. */
export class BaselineLines {
  #known = new Map(); // line → change in dB; null without a baseline, undefined while it is requested
  #onAnswer;

  constructor(onAnswer) {
    this.#onAnswer = onAnswer;
  }

  /**
   * The changes in dB of the lines of a spectrum at the positions `at`: null where there is no baseline,
   * undefined where the response is awaited. Envelope spectra are compared in the band of this one.
   * @param {any} spectrum
   * @param {number[]} at
   * @returns {(number | null | undefined)[]}
   */
  changes({ segment_id: id, axis, band_hz: band }, at) {
    if (!id) return at.map(() => null);
    const name = (x) => `${id} ${axis ? "orders" : "hz"} ${band ?? ""} ${place(x)}`;
    const missing = at.filter((x) => !this.#known.has(name(x)));
    if (this.#known.size > KEPT) this.#known.clear();
    for (const x of missing) this.#known.set(name(x), undefined);
    for (let n = 0; n < missing.length; n += LINES_PER_REQUEST)
      this.#ask(id, axis ? "orders" : "hz", band, missing.slice(n, n + LINES_PER_REQUEST).map(place), name);
    return at.map((x) => this.#known.get(name(x)));
  }

  async #ask(id, axis, band, at, name) {
    try {
      const { items } = await api.lines(id, at, axis, band);
      for (const [n, x] of at.entries()) this.#known.set(name(x), items[n].change_db ?? null);
    } catch (error) {
      const isRefused = error instanceof api.ApiError;
      // Without a connection the lines are requested again when they are shown again
      for (const x of at) {
        if (isRefused) this.#known.set(name(x), null);
        else this.#known.delete(name(x));
      }
      if (!isRefused) return;
    }
    this.#onAnswer();
  }
}
