// Wear before an inspection, re-estimated from the inspection (hindsight).

import * as api from "./api.js";

let known = { key: "", items: [] };

/**
 * The re-estimated records before the last inspection; none without an inspection. The service computes them
 * on request, so they are requested again only when what they follow from has changed.
 */
export async function hindsightOf({ id, updated_at }, channel, maintenance, signal) {
  const events = maintenance instanceof Error ? [] : maintenance.items;
  const inspected = events.filter(({ inspection }) => inspection).map(({ time }) => Date.parse(time));
  if (inspected.length === 0) return [];
  const to = new Date(Math.max(...inspected)).toISOString();
  const counted = [undefined, "excluded"].map((status) =>
    api.settle(api.recordCount(id, { channel, to, status }, signal)),
  );
  const key = JSON.stringify([id, updated_at, channel, events, await Promise.all(counted)]);
  if (known.key !== key) {
    const response = await api.settle(api.wearHindsight(id, channel, signal));
    if (response instanceof Error || response.items.length === 0) return [];
    known = { key, items: response.items };
  }
  return known.items;
}

/** The hindsight interval as two lines: `{ traces, entries }`. */
export function hindsightLines(items, colour) {
  if (!items?.length) return { traces: [], entries: [] };
  const line = { color: colour.reference, width: 1, dash: "dash" };
  const edge = (key) => ({
    x: items.map(({ start_time: time }) => time),
    y: items.map((item) => item[key]),
    mode: "lines",
    line,
    hoverinfo: "skip",
  });
  return {
    traces: [edge("low_um"), edge("high_um")],
    entries: [["dash", colour.reference, "90 % interval, in hindsight of the inspection"]],
  };
}
