// Wear before an inspection, re-estimated from the inspection (hindsight).

import * as api from "./api.js";

let known = { key: "", items: [] };

/**
 * The re-estimated records before the last inspection; none without an inspection. The service computes them
 * on request, so they are requested once.
 */
export async function hindsightOf(id, channel, maintenance, signal) {
  const inspections =
    maintenance instanceof Error ? [] : maintenance.items.filter(({ inspection }) => inspection);
  if (inspections.length === 0) return [];
  const key = JSON.stringify([id, channel, inspections.map(({ time, inspection }) => [time, inspection])]);
  if (known.key !== key) {
    const answer = await api.answer(api.wearHindsight(id, channel, signal));
    if (answer instanceof Error || answer.items.length === 0) return [];
    known = { key, items: answer.items };
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
