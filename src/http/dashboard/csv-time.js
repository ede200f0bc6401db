// The time column of a CSV file: how it is told from vibration, and what it says of the sampling rate and the
// start.

const NAMES =
  /^(t|time|zeit|zeitstempel|zeitpunkt|uhrzeit|datum|date|date ?time|time ?stamp|elapsed|seconds?|sekunden?|temps|tiempo|tempo|tijd|tid|czas)$/i;
const BEGINS = /^(time|zeit)[ _\-/:]/i; // Time - a1, Zeit_1
const BRACKETED = /[([]\s*(s|sec|sek|seconds?|ms|µs|μs|us|ns)\.?\s*[)\]]$/i;
const AFTER = /[ _/,]\s*(s|sec|sek|seconds?|ms|µs|μs|us|ns)$/i; // time_s, t / ms
const SCALES = { ms: 1e-3, µs: 1e-6, μs: 1e-6, us: 1e-6, ns: 1e-9 };
const EVEN = 0.5; // of a step that one step may differ: times are often rounded
const EPOCH = 1e8; // as seconds this is the year 1973: no record is so long

const ISO = /^(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?\s*(Z|[+-]\d\d:?\d\d)?$/i;
const GERMAN = /^(\d\d?)\.(\d\d?)\.(\d{4})[ T]+(\d\d?):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?$/;

/** A time of day and date in seconds since 1970, UTC where no zone is said; NaN where it is none. */
export function stampSeconds(text) {
  const iso = ISO.exec(text);
  const [, day, month, year, ...clock] = GERMAN.exec(text) ?? [];
  if (!iso && !year) return NaN;
  const [y, mo, d, h, mi, s, fraction, zone] = iso ? iso.slice(1) : [year, month, day, ...clock];
  const [, sign, hours, minutes] = /^([+-])(\d\d):?(\d\d)$/.exec(zone ?? "") ?? [];
  const offset = sign ? Number(`${sign}1`) * (60 * Number(hours) + Number(minutes)) * 60 : 0;
  const [toYear, toMonth, toDay, toHour, toMinute, toSecond] = [y, mo, d, h, mi, s ?? 0].map(Number);
  const seconds = Date.UTC(toYear, toMonth - 1, toDay, toHour, toMinute, toSecond) / 1000;
  return seconds - offset + Number(`0.${fraction || 0}`);
}

/** Whether a column's name says that it holds the time; of a mere ending like `_s` only where its values rise evenly. */
function isNamedTime(name, rises) {
  const text = name.trim();
  const stem = text.replace(BRACKETED, "").replace(AFTER, "").trim();
  return (
    NAMES.test(text) ||
    NAMES.test(stem) ||
    BEGINS.test(text) ||
    BRACKETED.test(text) ||
    (AFTER.test(text) && rises)
  );
}

/** The first place where values do not go on as on average, from 0; -1 where they rise evenly throughout. */
function unevenAt(values) {
  const step = (values.at(-1) - values[0]) / (values.length - 1);
  if (!(step > 0 && Number.isFinite(step))) return 0;
  for (let n = 0; n < values.length - 1; n++)
    if (!(Math.abs((values[n + 1] - values[n]) / step - 1) <= EVEN)) return n;
  return -1;
}

/** The unit of a column of times in seconds; large numbers count from 1970, in what unit their size says. */
function scaleOf(name, first) {
  const unit = (BRACKETED.exec(name) ?? AFTER.exec(name))?.[1]?.toLowerCase();
  if (unit in SCALES) return SCALES[unit];
  if (first < 1e11) return 1;
  return first < 1e14 ? 1e-3 : first < 1e17 ? 1e-6 : 1e-9;
}

/** When a first value of a column called `name` is, as an ISO time; null where it does not count from 1970. */
export function startOf(name, first) {
  const seconds = first * scaleOf(name.trim(), first);
  return seconds > EPOCH && seconds < 1e11 ? new Date(Math.round(1000 * seconds)).toISOString() : null;
}

/**
 * Which column is the time: `{ index, rate }`, the rate in hertz; `index` -1 where none is. `stamps` says that the first column held dates;
 * `chosen` is the column that a person chose, -1 for none. Words where a column cannot be what it seems to be.
 */
export function timeColumn(names, columns, stamps, chosen) {
  if (chosen === -1) return { index: -1 };
  const uneven = unevenAt(columns[0]);
  const isFirst = stamps || isNamedTime(names[0], uneven < 0);
  const index = chosen ?? (isFirst ? 0 : names.findIndex((name) => NAMES.test(name.trim())));
  if (index < 0) {
    const ramp = uneven < 0 && columns.length > 1 && columns[0].length > 3;
    return ramp
      ? {
          words: `column “${names[0]}” rises by the same step from row to row, which no vibration does: call it time if it is the time, or take it out`,
        }
      : { index };
  }
  const times = columns[index];
  const [last, at] = [times.length - 1, unevenAt(times)];
  const scale = stamps && index === 0 ? 1 : scaleOf(names[index].trim(), times[0]);
  const rate = last / ((times[last] - times[0]) * scale);
  if (!(rate > 0 && Number.isFinite(rate)))
    return {
      words: `the times in column “${names[index]}” run from ${times[0]} to ${times[last]}, expected rising times`,
    };
  if (at >= 0)
    return {
      words: `between rows ${at + 1} and ${at + 2} the time in column “${names[index]}” goes on by ${(times[at + 1] - times[at]) * scale} s, expected ${1 / rate} s as on average: samples are missing`,
    };
  return { index, rate };
}
