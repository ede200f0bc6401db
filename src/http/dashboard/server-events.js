// Server-sent events, read with fetch because EventSource cannot send a token.

import { failure } from "./api.js";

const SILENT_MS = 45_000; // the server sends something every 15 s; after three missed intervals the connection is dead

/**
 * Reads the events of an address until they end: calls `onOpen()` at the start and `onEvent({ kind, id, data
 * })` for each.
 */
export async function readEvents(href, { headers = {}, signal = undefined, onOpen = () => {}, onEvent }) {
  const abort = new AbortController();
  const response = await fetch(href, {
    headers: { accept: "text/event-stream", ...headers },
    signal: signal ? AbortSignal.any([signal, abort.signal]) : abort.signal,
    cache: "no-store",
  });
  if (!response.ok) throw failure(response.status, await response.text());
  onOpen();
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const silence = setTimeout(() => abort.abort(), SILENT_MS);
    const { done, value } = await reader.read().finally(() => clearTimeout(silence));
    if (done) return;
    const blocks = (text + value).replaceAll("\r\n", "\n").split("\n\n");
    text = blocks.pop();
    for (const block of blocks) take(block, onEvent);
  }
}

function take(block, onEvent) {
  const fields = block
    .split("\n")
    .map((line) => /^(\w+): ?(.*)$/.exec(line))
    .filter(Boolean);
  const field = (name) => fields.find(([, key]) => key === name)?.[2];
  if (fields.length) onEvent({ kind: field("event") ?? "message", id: field("id"), data: field("data") });
}
