// What the server tells of itself: a stream of server-sent events, read with fetch, because EventSource
// cannot show a token.

import { address } from "./api.js";

const AGAIN_MS = 10_000;
const SILENT_MS = 45_000; // the server says something every 15 s; after three times nothing the connection is dead

/** Follows `/v1/events`; `onEvent(kind)` for each, `onState(connected)` when the stream begins and ends. */
export class Events {
  #onEvent;
  #onState;
  #last = null;
  #connected = false;

  constructor(onEvent, onState) {
    this.#onEvent = onEvent;
    this.#onState = onState;
    this.#follow();
  }

  async #follow() {
    for (;;) {
      try {
        await this.#read();
      } catch {
        // lost or refused: polling goes on meanwhile
      }
      this.#set(false);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  async #read() {
    const abort = new AbortController();
    const headers = { accept: "text/event-stream", ...(this.#last && { "last-event-id": this.#last }) };
    const response = await fetch(address(["events"]), { headers, signal: abort.signal, cache: "no-store" });
    if (!response.ok) throw new Error(`the server answered ${response.status}`);
    this.#set(true);
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const silence = setTimeout(() => abort.abort(), SILENT_MS);
      const { done, value } = await reader.read();
      clearTimeout(silence);
      if (done) return;
      const blocks = (text + value).replaceAll("\r\n", "\n").split("\n\n");
      text = blocks.pop();
      for (const block of blocks) this.#take(block);
    }
  }

  #take(block) {
    const fields = block
      .split("\n")
      .map((line) => /^(\w+): ?(.*)$/.exec(line))
      .filter(Boolean);
    const field = (name) => fields.find(([, key]) => key === name)?.[2];
    const id = field("id");
    if (id) this.#last = id;
    if (field("data") !== undefined) this.#onEvent(field("event") ?? "message");
  }

  #set(connected) {
    if (connected === this.#connected) return;
    this.#connected = connected;
    this.#onState(connected);
  }
}
