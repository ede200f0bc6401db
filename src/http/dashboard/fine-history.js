// A long history is fetched in reduced form. Of a range of time that is zoomed in to, every record is
// fetched.

const MARGIN = 0.1; // of a range, on either side, so that lines reach the edges of the plot

/**
 * A history with the records of a range at full resolution in place of its reduced ones; `part` says whether
 * these are reduced too. `ask(range)` requests the records of a range of ISO times.
 * @template {{ items: any[], reduced: boolean }} T
 * @param {T | Error} whole
 * @param {string[] | null} range
 * @param {(range: { from: string, to: string }) => Promise<T | Error>} ask
 * @returns {Promise<T & { part?: { reduced: boolean } } | Error>}
 */
export async function withFineItems(whole, range, ask) {
  if (whole instanceof Error || !whole.reduced || !range) return whole;
  const [begin, end] = range.map((time) => Date.parse(time));
  const margin = MARGIN * (end - begin);
  const [from, to] = [begin - margin, end + margin];
  const part = await ask({ from: new Date(from).toISOString(), to: new Date(to).toISOString() });
  if (part instanceof Error) return whole;
  const outside = (keep) => whole.items.filter(({ start_time: time }) => keep(Date.parse(time)));
  return {
    ...whole,
    items: [...outside((time) => time < from), ...part.items, ...outside((time) => time >= to)],
    part: { reduced: part.reduced },
  };
}

/** How much of a long history is drawn; empty if it is drawn whole. */
export function detailWords({ reduced, part }) {
  if (!reduced) return "";
  return part && !part.reduced
    ? " Every record of the visible time is drawn."
    : " Reduced for display, extremes preserved: zoom in to see every record.";
}
