// When a file's record began: from its contents, from a date in its name, or from when the file was changed
// last.

const NAME =
  /(?<!\d)((?:19|20)\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?:[T _.-]*([01]\d|2[0-3])[-_.:h]?([0-5]\d)(?:[-_.:m]?([0-5]\d)(?:[.,_](\d{1,6}))?)?)?(?!\d)/;

/** The time that a file's name holds, read as UTC, as an ISO time; null without one. */
export function startInName(name) {
  const [, ...parts] = NAME.exec(name.replace(/\.\w+$/, "")) ?? [];
  if (parts.length === 0) return null;
  const [year, month, day, hour, minute, second] = parts.slice(0, 6).map((part) => Number(part ?? 0));
  const fraction = Math.round(1000 * Number(`0.${parts[6] || 0}`));
  const time = new Date(Date.UTC(year, month - 1, day, hour, minute, second) + fraction);
  return time.getUTCDate() === day ? time.toISOString() : null; // there is no 31 February
}

/** `{ time, source }` of a file: an ISO time and where it is from. `told` is what its samples say, null where they do not. */
export function startOfFile(file, told) {
  if (told) return { time: told, source: "from its time column" };
  const named = startInName(file.name);
  if (named) return { time: named, source: "from its name, read as UTC" };
  return {
    time: new Date(file.lastModified).toISOString(),
    source: "when the file was changed last: check it",
  };
}
