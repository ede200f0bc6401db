// Asks the service for previews one after the other: what is wanted while one is under way is asked next, and
// only the latest of it.

import * as api from "./api.js";

const AGAIN_MS = 1000;

/** Previews for one view; `onAnswer(preview, request)` and `onError(error)` are called in the order of the requests. */
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

  /** Asks for a preview at once, or after some milliseconds in which nothing else is asked. */
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

  /** Asks and answers no more. */
  dispose() {
    clearTimeout(this.#timer);
    this.#ended = true;
  }
}
