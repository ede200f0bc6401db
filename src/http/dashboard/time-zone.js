// The time zone of displayed times: UTC, or the browser's. Once selected it is remembered by the browser and
// part of every address, so that a link shows the times that its sender saw.

import { format, parse } from "./route.js";

const KEY = "flankwatch-times";
const CHOICES = ["utc", "local"];
const HOUR_MS = 3_600_000;

function stored() {
  try {
    const choice = localStorage.getItem(KEY);
    return CHOICES.includes(choice) ? choice : null;
  } catch {
    return null; // storage is unavailable in some private windows
  }
}

let choice = stored(); // null until selected: UTC

/** Whether times are shown in the browser's time zone. */
export const isLocal = () => choice === "local";

/** The time zone's name beside a field or an axis. */
export const zoneName = () => (isLocal() ? "local time" : "UTC");

/** A time in the selected zone: ISO 8601 without a zone, to the millisecond. */
export function written(time) {
  const date = new Date(time);
  const offset_ms = isLocal() ? date.getTimezoneOffset() * 60_000 : 0;
  return new Date(date.getTime() - offset_ms).toISOString().slice(0, -1);
}

/** The zone of such a time: `UTC`, or its offset. */
export function zoneOf(time) {
  if (!isLocal()) return "UTC";
  const ahead = -new Date(time).getTimezoneOffset();
  const two = (value) => String(Math.floor(value)).padStart(2, "0");
  return `${ahead < 0 ? "−" : "+"}${two(Math.abs(ahead) / 60)}:${two(Math.abs(ahead) % 60)}`;
}

/**
 * Parses a time in the selected zone into an ISO time in UTC; also accepts a date alone and a space before
 * the time.
 */
export function instant(text) {
  const full = text.replace(" ", "T").replace(/^(\d+-\d+-\d+)$/, "$1T00:00");
  return new Date(isLocal() ? full : `${full}Z`).toISOString();
}

/** By how much local time is ahead of UTC. */
const ahead = (ms) => -new Date(ms).getTimezoneOffset() * 60_000;

/** The times around a moment at which local clocks show one hour twice; null if they do not. */
function shownTwice(ms) {
  if (!isLocal()) return null;
  let [before, after] = [ms - HOUR_MS, ms + HOUR_MS];
  const back = ahead(before) - ahead(after);
  if (back <= 0) return null;
  while (after - before > 1) {
    const middle = Math.floor((before + after) / 2);
    if (ahead(middle) === ahead(after)) after = middle;
    else before = middle;
  }
  const [from, to] = [after - back, after + back];
  return from <= ms && ms < to ? { from, to } : null;
}

/**
 * A time on an axis, as `written`. Both passes of an hour that clocks show twice share its place, so that no
 * line runs backwards.
 */
export function onAxis(time) {
  const ms = new Date(time).getTime();
  const { from = ms } = shownTwice(ms) ?? {};
  return written(from + (ms - from) / 2);
}

/** The time of such a place on an axis. */
export function fromAxis(text) {
  const ms = Date.parse(instant(text));
  const { from = ms } = shownTwice(ms) ?? {};
  return new Date(from + (ms - from) * 2).toISOString();
}

/** Writes the selected zone to the address. */
function intoAddress(route) {
  // An unknown address stays as it is
  if (!choice || route.page === "unknown" || route.query.times === choice) return route;
  const whole = { ...route, query: { ...route.query, times: choice } };
  history.replaceState(null, "", format(whole));
  return whole;
}

/** The route of the current address, with the zone; whether the address has selected another zone. */
export function routeWithZone(select) {
  const route = parse(location.hash);
  const given = CHOICES.includes(route.query.times) ? route.query.times : choice;
  const isOther = (given ?? "utc") !== (choice ?? "utc");
  choice = given;
  select.value = choice ?? "utc";
  return { route: intoAddress(route), isOther };
}

/** Binds the time-zone selector; `onChange` redraws everything. */
export function bindTimeChoice(select, onChange) {
  select.value = choice ?? "utc";
  select.addEventListener("change", () => {
    choice = select.value;
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // The choice then lasts as long as the address has it
    }
    intoAddress(parse(location.hash));
    onChange();
  });
}
