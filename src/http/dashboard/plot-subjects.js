// Captions of plots: asset and time. Every picture has one, as it may be viewed apart from the page.

import { assetName } from "./fleet-row.js";
import { clock } from "./format.js";

/** A record of an asset. */
export function recordSubject(segment, asset) {
  return `${assetName(asset)} · ${segment.channel} · ${clock(segment.start_time)}`;
}

/** The life of an asset's channel; `items` are its records in order of time. */
export function lifeSubject(asset, channel, items) {
  const times = [items[0], items.at(-1)].map((item) => clock(item?.start_time));
  return `${assetName(asset)} · ${channel} · ${[...new Set(times)].join(" to ")}`;
}
