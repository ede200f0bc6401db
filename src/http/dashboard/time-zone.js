// The clock that times are shown by: UTC, or that of the browser.

const KEY = "flankwatch-times";

function stored() {
  try {
    return localStorage.getItem(KEY) === "local" ? "local" : "utc";
  } catch {
    return "utc"; // storage is refused in some private windows
  }
}

let choice = stored();

/** Whether times are those of the browser's zone. */
export const isLocal = () => choice === "local";

/** What the clock is called beside a field or an axis. */
export const zoneName = () => (isLocal() ? "local time" : "UTC");

/** A time as the clock shows it: ISO 8601 without a zone, to the millisecond. */
export function written(time) {
  const date = new Date(time);
  const offset_ms = isLocal() ? date.getTimezoneOffset() * 60_000 : 0;
  return new Date(date.getTime() - offset_ms).toISOString().slice(0, -1);
}

/** The zone of a time so written: `UTC`, or how far the clock is ahead of it. */
export function zoneOf(time) {
  if (!isLocal()) return "UTC";
  const ahead = -new Date(time).getTimezoneOffset();
  const two = (value) => String(Math.floor(value)).padStart(2, "0");
  return `${ahead < 0 ? "−" : "+"}${two(Math.abs(ahead) / 60)}:${two(Math.abs(ahead) % 60)}`;
}

/** The time that the clock shows so, as an ISO time in UTC; takes a day alone and a space before the hour too. */
export function instant(text) {
  const full = text.replace(" ", "T").replace(/^(\d+-\d+-\d+)$/, "$1T00:00");
  return new Date(isLocal() ? full : `${full}Z`).toISOString();
}

/** Makes a select choose the clock; `onChange` shows everything anew. */
export function bindTimeChoice(select, onChange) {
  select.value = choice;
  select.addEventListener("change", () => {
    choice = select.value;
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // the choice then lasts as long as the page
    }
    onChange();
  });
}
