// The start time of a file's record: from its contents, a date in its name, or its modification time.

const NAME =
  /(?<!\d)((?:19|20)\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?:[T _.-]*([01]\d|2[0-3])[-_.:h]?([0-5]\d)(?:[-_.:m]?([0-5]\d)(?:[.,_](\d{1,6}))?)?)?(?!\d)/;

/** The time in a file's name, read as UTC, as an ISO time; null when there is none. */
function startInName(name) {
  const [, ...parts] = NAME.exec(name.replace(/\.\w+$/, "")) ?? [];
  if (parts.length === 0) return null;
  const [year, month, day, hour, minute, second] = parts.slice(0, 6).map((part) => Number(part ?? 0));
  const fraction = Math.round(1000 * Number(`0.${parts[6] || 0}`));
  const time = new Date(Date.UTC(year, month - 1, day, hour, minute, second) + fraction);
  return time.getUTCDate() === day ? time.toISOString() : null; // there is no 31 February
}

/**
 * `{ time, source, isGuess }` of a file: an ISO time and its source. `startTime` is the start time in its samples, or null.
 */
export function startOfFile(file, startTime) {
  if (startTime) return { time: startTime, source: "from its time column" };
  const named = startInName(file.name);
  if (named) return { time: named, source: "from the file name, read as UTC" };
  return {
    time: new Date(file.lastModified).toISOString(),
    source: "modification time of the file: please check",
    isGuess: true,
  };
}
