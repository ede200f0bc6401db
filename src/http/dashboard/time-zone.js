// The time zone of displayed times: UTC, or the browser's.

const KEY = "flankwatch-times";

function stored() {
  try {
    return localStorage.getItem(KEY) === "local" ? "local" : "utc";
  } catch {
    return "utc"; // storage is unavailable in some private windows
  }
}

let choice = stored();

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

/** Binds the time-zone selector; `onChange` redraws everything. */
export function bindTimeChoice(select, onChange) {
  select.value = choice;
  select.addEventListener("change", () => {
    choice = select.value;
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // the choice then lasts until the page is closed
    }
    onChange();
  });
}
