// Requests previews one after the other; while one is running, only the latest further request is kept.

import * as api from "./api.js";

const AGAIN_MS = 1000;

/**
 * Previews for one view; calls `onAnswer(preview, request)` and `onError(error)` in the order of the
 * requests.
 */
export class PreviewRequests {
  #onAnswer;
  #onError;
  #wanted;
  #running = false;
  #timer;
  #ended = false;

  constructor(onAnswer, onError) {
    [this.#onAnswer, this.#onError] = [onAnswer, onError];
  }

  /** Requests a preview at once, or after some milliseconds without another request. */
  ask(request, wait = 0) {
    clearTimeout(this.#timer);
    if (wait) {
      this.#timer = setTimeout(() => this.ask(request), wait);
      return;
    }
    this.#wanted = request;
    if (!this.#running) this.#run();
  }

  async #run() {
    this.#running = true;
    while (this.#wanted && !this.#ended) {
      const request = this.#wanted;
      this.#wanted = undefined;
      try {
        const preview = await api.preview(request);
        if (!this.#ended) await this.#onAnswer(preview, request);
      } catch (error) {
        if (this.#ended) break;
        this.#onError(error);
        if (error instanceof api.ConnectionError) {
          await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
          this.#wanted ??= request;
        }
      }
    }
    this.#running = false;
  }

  /** Stops requests and callbacks. */
  dispose() {
    clearTimeout(this.#timer);
    this.#ended = true;
  }
}
