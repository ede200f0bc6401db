// The views of a record: what each fetches and how it is drawn.

import * as api from "./api.js";
import { cepstrumDrawing } from "./cepstrum-plot.js";
import { cursorOf } from "./cursor-lines.js";
import { readByCursor, withFineLines } from "./fine-lines.js";
import { gearsIn } from "./gear-choice.js";
import { posteriorDrawing } from "./posterior-plot.js";
import {
  envelopeDrawing,
  envelopeParts,
  isNear,
  ofOrders,
  overOrders,
  spectrumDrawing,
  zoomRange,
} from "./spectrum-plot.js";
import { ended } from "./state.js";
import { turnDrawing } from "./turn-plot.js";
import { waveformDrawing } from "./waveform-plot.js";

const DEFAULT = "spectrum,envelope,posterior";
const POINTS = 4000; // of a whole spectrum

/** Parses `part` (seconds) or `band` (hertz or orders) of an address into `[from, to]`, or null. */
export function partOf(text) {
  const [from, to] = (text ?? "").split("~").map(Number);
  return from >= 0 && to > from ? [from, to] : null;
}

/** Formats a range for an address; null for no range. */
export function formatPart(range) {
  return range && range.map((end) => Number(Math.max(0, end).toPrecision(6))).join("~");
}

function waveform(id, query, signal, options) {
  const [from, to] = partOf(query.part) ?? [];
  return api.waveform(id, from, to, signal, options?.motion);
}

/** Refuses what needs the shaft's angle of a record that has none; `noAngle()` gives the reason, or null. */
async function requireAngle(what, noAngle) {
  const reason = await noAngle?.();
  if (reason) throw new api.ApiError(422, { detail: `No ${what}: ${reason}.` });
}

async function spectrum(id, query, signal, { points = POINTS, noAngle = undefined } = {}) {
  if (query.axis === "orders") await requireAngle("spectrum over orders", noAngle);
  const ask = async (...range) =>
    query.axis === "orders"
      ? ofOrders(await api.orders(id, ...range, signal))
      : api.spectrum(id, ...range, signal);
  const whole = await ask(null, null, points);
  return withFineLines(
    whole,
    partOf(query.band) ?? zoomRange(whole, query.zoom),
    readByCursor(cursorOf(query, whole), whole),
    ask,
  );
}

async function envelope(
  id,
  query,
  signal,
  { points = POINTS, band = null, envelopeOverOrders = false, bearings = {} } = {},
) {
  const inHertz = (...range) => api.envelope(id, ...range, signal, band);
  const first = await inHertz(null, null, points);
  if (envelopeOverOrders && !first.shaft_speed_hz)
    throw new api.ApiError(422, { detail: "the shaft speed of this record is unknown, so it has no orders" });
  const shaft = first.shaft_speed_hz;
  const whole = envelopeOverOrders ? overOrders(first, shaft) : first;
  const ask = envelopeOverOrders
    ? async (from, to, most) => overOrders(await inHertz(from * shaft, to * shaft, most), shaft)
    : inHertz;
  const { part, read } = envelopeParts(whole, isNear(query, bearings), bearings);
  const cursor = cursorOf(query, whole, "ecursor");
  return withFineLines(whole, partOf(query.eband) ?? part, cursor ? readByCursor(cursor, whole) : read, ask);
}

/** The average of one gear; with both, that of the driven one is its `driven`. */
async function turn(id, query, signal, options) {
  await requireAngle("average over one turn", options?.noAngle);
  const [first, driven] = await Promise.all(gearsIn(query).map((gear) => api.turn(id, gear, signal)));
  return driven ? { ...first, driven } : first;
}

function posterior({ segment, asset, revision }) {
  const { wear, reference_wear_um: reference } = segment;
  if (wear?.status === "outside_library")
    return "No posterior: this record is not explained by wear. See the page “Match” for the deviations.";
  if (!wear?.posterior)
    return wear?.reason ? ended(`No posterior: ${wear.reason}`) : "No posterior for this record.";
  return posteriorDrawing(wear, asset.limits, reference, revision);
}

/** What a machine's lines follow from: tooth counts of its mesh, orders of its bearings. */
const machineLines = ({ gear, summary }) => ({ teeth: gear?.teeth, bearings: summary.bearing_orders ?? {} });

/**
 * Each pane's `fetch(id, query, signal, options)` fetches its data; `draw(layers, context)` returns a drawing
 * of the records in `layers`, or a text when there is nothing to draw.
 * @type {{ key: string, label: string, fetch?: (...asked: any[]) => Promise<any>, draw: (...drawn: any[]) => any }[]}
 */
export const PANES = [
  {
    key: "waveform",
    label: "Waveform",
    fetch: waveform,
    draw: (layers, { duration, query, revision }) =>
      waveformDrawing(layers, partOf(query.part), duration, revision),
  },
  {
    key: "spectrum",
    label: "Spectrum",
    fetch: spectrum,
    draw: (layers, { view, revision, asset }) =>
      layers[0].data.frequency_hz.length
        ? spectrumDrawing(layers, { ...view, hasMesh: Boolean(asset.gear) }, revision)
        : "The record is too short for a spectrum.",
  },
  {
    key: "envelope",
    label: "Envelope spectrum",
    fetch: envelope,
    draw: (layers, { asset, view, query, revision }) => {
      const shown = { ...view, part: view.envelopePart, isMarked: query.ecursor === "b" };
      return layers[0].data.frequency_hz.length
        ? envelopeDrawing(layers, machineLines(asset), shown, revision)
        : "The record is too short for a spectrum.";
    },
  },
  {
    key: "turn",
    label: "Average over one turn",
    fetch: turn,
    draw: (layers, { revision }) => turnDrawing(layers, revision),
  },
  {
    key: "cepstrum",
    label: "Cepstrum",
    fetch: (id, query, signal) => api.cepstrum(id, 0.2, signal),
    draw: (layers, { revision }) => cepstrumDrawing(layers, revision),
  },
  {
    key: "posterior",
    label: "Posterior over wear depth",
    draw: (layers, context) => posterior(context),
  },
];

/** The keys of the panes selected in an address. */
export function shownPanes(query) {
  const keys = (query.show ?? DEFAULT).split(",");
  return PANES.filter(({ key }) => keys.includes(key)).map(({ key }) => key);
}

/**
 * Fetches the data of the displayed panes, as answers or errors by the panes' keys.
 * @param {string} id
 * @param {Record<string, string>} query
 * @param {AbortSignal} [signal]
 * @param {{ points?: number, band?: number[], envelopeOverOrders?: boolean, bearings?: object, noAngle?: () => Promise<string | null> }} [options] points of a spectrum, the band of the envelope, the machine's bearings, and why the record has no shaft angle
 * @returns {Promise<Record<string, any>>}
 */
export async function fetchPanes(id, query, signal, options) {
  const panes = PANES.filter(({ key, fetch }) => fetch && shownPanes(query).includes(key));
  const answers = await Promise.all(panes.map(({ fetch }) => api.settle(fetch(id, query, signal, options))));
  return Object.fromEntries(panes.map(({ key }, index) => [key, answers[index]]));
}
