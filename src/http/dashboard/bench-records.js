// The records on the bench: kept in the page's address and for this browser tab, so that a record's page can
// add to them.

import { format, go, parse } from "./route.js";

/** The maximum number of records, limited by distinguishable colours. */
export const MAX_RECORDS = 8;

const KEY = "flankwatch-bench";

/** The records of an address, without duplicates; the first is the reference. */
export function recordsOf(query) {
  return [...new Set((query.records ?? "").split(",").filter(Boolean))].slice(0, MAX_RECORDS);
}

/** Formats records for an address. */
export const formatRecords = (ids) => ids.join(",") || null;

/** Saves the bench's view for this tab; the time zone is the browser's choice. */
export function saveBench(query) {
  try {
    sessionStorage.setItem(KEY, format({ page: "bench", query: { ...query, times: null } }));
  } catch {
    // Storage unavailable: the view is kept by the address alone
  }
}

/** The last parameters of the bench in this tab. */
export function loadBench() {
  try {
    return parse(sessionStorage.getItem(KEY) ?? "").query;
  } catch {
    return {};
  }
}

/** Adds records to the bench and goes to it; returns an error message when there are too many. */
export function compareOnBench(ids) {
  const kept = loadBench();
  const together = [...new Set([...recordsOf(kept), ...ids])];
  const fit = together.length <= MAX_RECORDS ? together : ids;
  if (fit.length > MAX_RECORDS)
    return `${ids.length} records selected; at most ${MAX_RECORDS} can be compared.`;
  const query = { ...kept, records: formatRecords(fit), part: null, band: null, eband: null };
  saveBench(query);
  go({ page: "bench", query });
  return "";
}
