// Captions and origins of plots: asset and time. Every picture and table has one, as it may be viewed apart
// from the page.

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

const named = (asset) => [
  ["Asset", assetName(asset) === asset.id ? asset.id : `${assetName(asset)} (${asset.id})`],
];

/** The lines before a table of a record, and of the `pinned` one beside it if any. */
export function recordOrigin(segment, asset, pinned) {
  return [
    ...named(asset),
    ["Channel", segment.channel],
    ["Start", segment.start_time],
    ["Sample rate", `${segment.sample_rate_hz} Hz`],
    ["Unit", segment.unit],
    ...(pinned?.start_time ? [["Pinned record", `${pinned.channel}, ${pinned.start_time}`]] : []),
  ];
}

/** The lines before a table over the life of an asset's channel. */
export const lifeOrigin = (asset, channel, items) => [
  ...named(asset),
  ["Channel", channel],
  ["From", items[0]?.start_time],
  ["To", items.at(-1)?.start_time],
];

/** The time range of records in a file name. */
export function lifeSpan(items) {
  const times = [items[0], items.at(-1)].map((item) => `${item?.start_time}`.replace(/(\.\d+)?Z$/, "Z"));
  return [...new Set(times)].join("-to-").replaceAll(":", "-");
}
