// The wear forecast from the last record to the limit.

import { depth } from "./format.js";
import { timeToLimit } from "./state.js";

const MAX_FRACTION = 0.6; // maximum length of a forecast on the time axis, as a fraction of the history

/** Traces of the forecast, the time range that shows it, and its text; null when there is no forecast. */
export function forecastOf(items, latest, colour) {
  const { prognosis } = latest ?? {};
  const last = items.findLast((item) => item.median_um != null);
  if (!prognosis || !last) return null;
  const { limit_um: limit, median, p05, p95 } = prognosis;
  const [first, end] = [Date.parse(items[0].start_time), Date.parse(items.at(-1).start_time)];
  const left = timeToLimit(latest, last.start_time);
  const farthest = end + Math.max(MAX_FRACTION * (end - first), 60_000);
  const shown = Math.min(Math.max(Date.parse(p95 ?? median), Date.parse(median)), farthest);
  const hoverinfo = "skip";
  const line = (time, dash, width) => ({
    x: [last.start_time, time],
    y: [last.median_um, limit],
    mode: "lines",
    line: { color: colour.series[1], width, dash },
    hoverinfo,
  });
  const late = p95 ?? new Date(farthest * 2 - end).toISOString();
  return {
    traces: [line(p05, "dot", 1), line(late, "dot", 1), line(median, "dash", 2)],
    range: [items[0].start_time, new Date(shown + 0.02 * (shown - first)).toISOString()],
    words: `forecast: ${depth(limit)} µm ${left.median} ${left.from} (90 %: ${left.interval})`,
  };
}
