// The units of the indicators that alarms watch: an alarm has none of its own, the trend of its indicator
// has.

import * as api from "./api.js";

const MOST = 40; // trends that are asked for at once
const known = new Map();

const key = ({ asset_id: asset, channel, quantity }) => JSON.stringify([asset, channel, quantity.indicator]);

/** The unit of an alarm's reading where it is known, empty where not. */
export function unitOf(alarm) {
  return (alarm.quantity?.indicator && known.get(key(alarm))) || "";
}

/** Asks for the units of alarms that are not known yet. */
export async function learnUnits(alarms, signal) {
  const asked = new Map(
    alarms
      .filter((alarm) => alarm.quantity?.indicator && !known.has(key(alarm)))
      .map((alarm) => [key(alarm), alarm]),
  );
  await Promise.all(
    [...asked].slice(0, MOST).map(async ([name, { asset_id: asset, channel, quantity }]) => {
      const answer = await api.answer(api.indicatorUnits(asset, channel, quantity.indicator, signal));
      if (!(answer instanceof Error)) known.set(name, answer.units[quantity.indicator] ?? "");
    }),
  );
}
