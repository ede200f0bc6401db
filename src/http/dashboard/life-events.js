// Events in an asset's life besides its records: maintenance, and the alarms of one channel, as marks on time
// plots.

import * as api from "./api.js";
import { fetchUnits } from "./alarm-units.js";
import { changeWords, quantityWords } from "./alarm-words.js";
import { verticalLine } from "./plots.js";

const MAX_ALARMS = 12; // histories fetched

/** Kinds of maintenance and their effect on the estimate. */
export const MAINTENANCE = {
  gear_replaced: {
    word: "Gears replaced",
    words: "Wear restarts at zero, a new baseline is collected, and wear alarms are cleared.",
  },
  sensor_replaced: {
    word: "Sensor replaced",
    words: "A new baseline is collected; wear continues from its current depth.",
  },
  regime_changed: {
    word: "Operation changed",
    words: "Load or speed changed: a new baseline is collected; wear continues from its current depth.",
  },
  inspected: {
    word: "Wear measured",
    words: "The depth was measured on the teeth; the estimate continues from there.",
  },
};

const OTHER_WORDS = { baseline_chosen: "Baseline chosen" }; // entered in the records table, not in the dialog

/** The name of a kind of maintenance. */
export const maintenanceWord = (kind) =>
  MAINTENANCE[kind]?.word ?? OTHER_WORDS[kind] ?? kind.replaceAll("_", " ");

const RAISED = "unacknowledged,acknowledged";

/**
 * Maintenance, the alarms of a channel with their histories, and those raised on `others`, as answers or
 * errors.
 */
export async function fetchEvents(id, channel, signal) {
  const [maintenance, list, raised] = await Promise.all([
    api.settle(api.maintenance(id, signal)),
    api.settle(api.alarms({ asset: id, channel, limit: MAX_ALARMS }, signal)),
    api.settle(api.alarms({ asset: id, state: RAISED, limit: MAX_ALARMS }, signal)),
  ]);
  const others = raised instanceof Error ? [] : raised.items.filter((alarm) => alarm.channel !== channel);
  const listed = list instanceof Error ? [] : list.items;
  const answers = await Promise.all(
    [...listed, ...others].map((alarm) => api.settle(api.alarm(alarm.id, signal))),
  );
  const known = answers.filter((alarm) => !(alarm instanceof Error));
  await fetchUnits(known, signal);
  const mine = (alarm) => alarm.channel === channel;
  return {
    maintenance,
    refused: list instanceof Error ? list : null,
    alarms: known.filter(mine),
    others: known.filter((alarm) => !mine(alarm)),
  };
}

/** Whether two answers of `fetchEvents` consist of the same objects. */
export function sameEvents(a, b) {
  const same = (one, other) => one.length === other.length && one.every((alarm, n) => alarm === other[n]);
  return (
    Boolean(a && b) && a.maintenance === b.maintenance && same(a.alarms, b.alarms) && same(a.others, b.others)
  );
}

/** What a quantity is computed from: an indicator, `novelty`, `wear_um`, … */
const subjectOf = (quantity) =>
  quantity?.rate_per_day
    ? subjectOf(quantity.rate_per_day)
    : (quantity?.indicator ??
      { wear_above_limit: "wear_um", joint_novelty: "novelty" }[quantity] ??
      quantity);

/** The events with the alarms of some quantities only, those that a plot shows. */
export const eventsOn = (events, names) => ({
  ...events,
  alarms: events.alarms.filter(({ quantity }) => names.includes(subjectOf(quantity))),
});

/** Times at which readings raised or ended an alarm. */
function changes(alarms) {
  return alarms.flatMap((alarm) =>
    alarm.history
      .filter(({ action, withdrawn_at: withdrawn }) => !action && !withdrawn)
      .map((change) => ({ alarm, change })),
  );
}

/** Alarm changes caused by a record, by its start time, as hover text. */
export function wordsAt({ alarms }) {
  const words = new Map();
  for (const { alarm, change } of changes(alarms)) {
    const text = `${quantityWords(alarm.quantity)}: ${changeWords(change, alarm)}`;
    words.set(change.time, [...(words.get(change.time) ?? []), text]);
  }
  return words;
}

const SYMBOLS = { danger: ["octagon", "danger"], warning: ["square", "warning"] };
const LABEL = 0.03; // width of a label along the line of an event, as a fraction of the plot
const STRIP_PX = 8; // from the plot's upper edge to the middle of a mark

/** A small mark above the plot at a time. */
function mark(time, name, colour) {
  const place = {
    xref: "x",
    xsizemode: "pixel",
    xanchor: time,
    yref: "paper",
    ysizemode: "pixel",
    yanchor: 1,
    line: { color: colour, width: 1.5 },
  };
  if (name === "octagon")
    return {
      ...place,
      type: "path",
      path: "M-2.500 2.500H2.500L6 6V10L2.500 13.500H-2.500L-6 10V6Z",
      fillcolor: colour,
    };
  const box = { x0: -5, x1: 5, y0: STRIP_PX - 5, y1: STRIP_PX + 5 };
  return name === "square"
    ? { ...place, ...box, type: "rect", fillcolor: colour }
    : { ...place, ...box, type: "circle" };
}

/**
 * Marks in a strip above the plot: octagon for danger, square for warning, hollow circle for back to normal;
 * maintenance as a labelled line over the whole plot. Returns `{ shapes, annotations, entries, top }`; `top`
 * is the height of the strip in pixels.
 */
export function eventMarks({ maintenance, alarms }, colour, items) {
  const [first, last] = [Date.parse(items[0].start_time), Date.parse(items.at(-1).start_time)];
  const within = (time) => Date.parse(time) >= first && Date.parse(time) <= last;
  const marks = changes(alarms).filter(({ change }) => within(change.time));
  const events = (maintenance instanceof Error ? [] : maintenance.items).filter(({ time }) => within(time));
  /** @type {[string | null, (change: any) => boolean, string][]} */
  const kinds = [
    ["danger", ({ severity }) => severity === "danger", "danger alarm raised"],
    ["warning", ({ severity }) => severity === "warning", "warning alarm raised"],
    [null, ({ severity }) => !severity, "alarm cleared"],
  ];
  /** @type {any[][]} */
  const [shapes, annotations, entries] = [[], [], []];
  for (const [severity, is, words] of kinds) {
    const some = marks.filter(({ change }) => is(change));
    if (some.length === 0) continue;
    const [name, ink] = SYMBOLS[severity] ?? ["circle", "muted"];
    entries.push([name, colour[ink], words]);
    shapes.push(...some.map(({ change }) => mark(change.time, name, colour[ink])));
  }
  shapes.push(...events.map(({ time }) => verticalLine(time, colour.reference, "dashdot", 1.5)));
  // Events too close for a label each share one
  const groups = [];
  for (const event of events.toSorted((a, b) => Date.parse(a.time) - Date.parse(b.time))) {
    const before = groups.at(-1)?.[0].time;
    if (before && Date.parse(event.time) - Date.parse(before) < LABEL * (last - first))
      groups.at(-1).push(event);
    else groups.push([event]);
  }
  for (const group of groups)
    annotations.push({
      x: group[0].time,
      yref: "paper",
      y: 0.98,
      yanchor: "top",
      xanchor: "right",
      textangle: -90,
      text: [...new Set(group.map(({ kind }) => maintenanceWord(kind)))].join(", "),
      showarrow: false,
      font: { color: colour.reference },
    });
  if (events.length) entries.push(["dash", colour.reference, "maintenance"]);
  return { shapes, annotations, entries, top: marks.length ? 14 : 0 };
}
