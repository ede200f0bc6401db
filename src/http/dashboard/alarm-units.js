// Units of the indicators watched by alarms. An alarm carries no unit, so it is taken from the indicator's
// trend.

import * as api from "./api.js";

const MAX_TRENDS = 40; // trends fetched at once
const known = new Map();

const key = ({ asset_id: asset, channel, quantity }) => JSON.stringify([asset, channel, quantity.indicator]);

/** The unit of an alarm's reading, or an empty string when it is unknown. */
export function unitOf(alarm) {
  return (alarm.quantity?.indicator && known.get(key(alarm))) || "";
}

/** Fetches the units of alarms that are not known yet. */
export async function fetchUnits(alarms, signal) {
  const asked = new Map(
    alarms
      .filter((alarm) => alarm.quantity?.indicator && !known.has(key(alarm)))
      .map((alarm) => [key(alarm), alarm]),
  );
  await Promise.all(
    [...asked].slice(0, MAX_TRENDS).map(async ([name, { asset_id: asset, channel, quantity }]) => {
      const response = await api.settle(api.indicatorUnits(asset, channel, quantity.indicator, signal));
      if (!(response instanceof Error)) known.set(name, response.units[quantity.indicator] ?? "");
    }),
  );
}
