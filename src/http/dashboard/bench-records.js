// Which records lie on the bench: in the address of its page, and for this tab of the browser, so that a
// record's page can add to them.

import { format, go, parse } from "./route.js";

/** The most records that are told apart by their colours. */
export const MOST_RECORDS = 8;

const KEY = "flankwatch-bench";

/** The records of an address, each once, the first one what the others are compared with. */
export function recordsOf(query) {
  return [...new Set((query.records ?? "").split(",").filter(Boolean))].slice(0, MOST_RECORDS);
}

/** Records as an address has them. */
export const formatRecords = (ids) => ids.join(",") || null;

/** Keeps the bench's view. */
export function keepBench(query) {
  try {
    sessionStorage.setItem(KEY, format({ page: "bench", query }));
  } catch {
    // the view is then kept by the address alone
  }
}

/** The parameters of the bench as it was last seen in this tab. */
export function keptBench() {
  try {
    return parse(sessionStorage.getItem(KEY) ?? "").query;
  } catch {
    return {};
  }
}

/** Puts records on the bench, beside those that lie there, and goes to it; words where there are too many. */
export function compareOnBench(ids) {
  const kept = keptBench();
  const together = [...new Set([...recordsOf(kept), ...ids])];
  const fit = together.length <= MOST_RECORDS ? together : ids;
  if (fit.length > MOST_RECORDS)
    return `${ids.length} records are selected, expected at most ${MOST_RECORDS} to compare.`;
  const query = { ...kept, records: formatRecords(fit), part: null, band: null, eband: null };
  keepBench(query);
  go({ page: "bench", query });
  return "";
}
