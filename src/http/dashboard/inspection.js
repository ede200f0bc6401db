// Wear measured on the teeth: description, and marks on the wear plot.

import { number } from "./format.js";

/** Gears that a measurement may be of, by their API value; the empty one is sent as null. */
export const GEARS = { "": "The more worn gear", 1: "Driving gear", 2: "Driven gear" };

/** Places on the flank. */
export const PLACES = {
  greatest: "At the deepest point",
  root: "At the root",
  pitch: "At the pitch point",
  tip: "At the tip",
};

/** Depth with its standard error, in the digits entered. */
export const measured = ({ depth_um: value, error_um: error }) => `${number(value)} ± ${number(error)} µm`;

/** Describes a measurement. */
export function inspectionWords(inspection) {
  const { gear, place } = inspection;
  return `${measured(inspection)}, ${GEARS[gear ?? ""].toLowerCase()}, ${PLACES[place ?? "greatest"].toLowerCase()}`;
}

/** Whether it measures what the wear plot shows: the greatest depth of both gears. */
const isGreatest = ({ gear, place }) => gear == null && (place ?? "greatest") === "greatest";

function markers(events, symbol, colour) {
  return {
    x: events.map(({ time }) => time),
    y: events.map(({ inspection }) => inspection.depth_um),
    error_y: {
      type: "data",
      array: events.map(({ inspection }) => inspection.error_um),
      color: colour.reference,
      thickness: 2,
      width: 5,
    },
    mode: "markers",
    marker: { symbol, size: 10, color: colour.reference, line: { width: 2, color: colour.reference } },
    cliponaxis: false,
    hoverinfo: "skip",
  };
}

const label = ({ time, inspection }, colour) => ({
  x: time,
  y: inspection.depth_um,
  text: measured(inspection),
  xanchor: "left",
  xshift: 9,
  yanchor: "top",
  yshift: -6,
  showarrow: false,
  font: { color: colour.reference },
});

/** Inspections between two times as points with error bars: `{ traces, annotations, entries }`. */
export function inspectionMarks({ maintenance }, colour, range) {
  const [from, to] = range;
  const within = ({ time, inspection }) =>
    inspection && Date.parse(time) >= Date.parse(from) && Date.parse(time) <= Date.parse(to);
  const inspections = maintenance instanceof Error ? [] : maintenance.items.filter(within);
  const kinds = [
    [
      inspections.filter(({ inspection }) => isGreatest(inspection)),
      "diamond",
      "measured depth ± standard error",
    ],
    [
      inspections.filter(({ inspection }) => !isGreatest(inspection)),
      "diamond-open",
      "measured on one gear or at one place, ± standard error",
    ],
  ].filter(([events]) => events.length);
  return {
    traces: kinds.map(([events, symbol]) => markers(events, symbol, colour)),
    annotations: inspections.map((event) => label(event, colour)),
    entries: kinds.map(([, symbol, words]) => [
      symbol === "diamond" ? "filled" : "diamond",
      colour.reference,
      words,
    ]),
  };
}
