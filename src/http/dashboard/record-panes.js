// The ways to look at a record: what each asks the server for and how it is drawn.

import * as api from "./api.js";
import { cepstrumDrawing } from "./cepstrum-plot.js";
import { readByCursor, withFineLines } from "./fine-lines.js";
import { posteriorDrawing } from "./posterior-plot.js";
import { envelopeDrawing, envelopeParts, ofOrders, spectrumDrawing, zoomRange } from "./spectrum-plot.js";
import { turnDrawing } from "./turn-plot.js";
import { waveformDrawing } from "./waveform-plot.js";

const DEFAULT = "spectrum,envelope,posterior";
const POINTS = 4000; // of a whole spectrum

/** `[from, to]` of an address's `part` in seconds or `band` in hertz or orders, or null. */
export function partOf(text) {
  const [from, to] = (text ?? "").split("~").map(Number);
  return from >= 0 && to > from ? [from, to] : null;
}

/** The same for an address; null for no range. */
export function formatPart(range) {
  return range && range.map((end) => Number(Math.max(0, end).toPrecision(6))).join("~");
}

function waveform(id, query, signal) {
  const [from, to] = partOf(query.part) ?? [];
  return api.waveform(id, from, to, signal);
}

async function spectrum(id, query, signal) {
  const ask = async (...range) =>
    query.axis === "orders"
      ? ofOrders(await api.orders(id, ...range, signal))
      : api.spectrum(id, ...range, signal);
  const whole = await ask(null, null, POINTS);
  return withFineLines(
    whole,
    partOf(query.band) ?? zoomRange(whole, query.zoom),
    readByCursor(query.cursor, whole),
    ask,
  );
}

async function envelope(id, query, signal) {
  const ask = (...range) => api.envelope(id, ...range, signal);
  const whole = await ask(null, null, POINTS);
  const { part, read } = envelopeParts(whole, query.near === "1");
  return withFineLines(whole, part, read, ask);
}

function posterior({ segment, asset, revision }) {
  const { wear, reference_wear_um: reference } = segment;
  if (wear?.status === "outside_library")
    return "No posterior: wear does not explain this record. The page “Match” says what is odd.";
  if (!asset.gear) return "No posterior: the machine has no gear mesh, so there is no wear to estimate.";
  if (!asset.gear.pair)
    return "No posterior: wear is not estimated, as no gear pair is described for this asset.";
  if (!wear?.posterior)
    return wear?.reason ? `No posterior: ${wear.reason}.` : "No posterior for this record.";
  return posteriorDrawing(wear, asset.limits, reference, revision);
}

/** What is known of a machine to have lines: the tooth numbers of its mesh, the orders of its bearings. */
const machineLines = ({ gear, summary }) => ({ teeth: gear?.teeth, bearings: summary.bearing_orders ?? {} });

/**
 * Each pane's `fetch(id, query, signal)` gives its data, `draw(data, other, context)` a drawing, or words where there is nothing to draw.
 * @type {{ key: string, label: string, fetch?: (...asked: any[]) => Promise<any>, draw: (...drawn: any[]) => any }[]}
 */
export const PANES = [
  {
    key: "waveform",
    label: "Waveform",
    fetch: waveform,
    draw: (data, other, { segment, query, revision }) =>
      waveformDrawing(data, other, partOf(query.part), segment.samples / segment.sample_rate_hz, revision),
  },
  {
    key: "spectrum",
    label: "Spectrum",
    fetch: spectrum,
    draw: (data, other, { view, revision }) =>
      data.frequency_hz.length
        ? spectrumDrawing(data, other, view, revision)
        : "The record is too short for a spectrum.",
  },
  {
    key: "envelope",
    label: "Envelope spectrum",
    fetch: envelope,
    draw: (data, other, { asset, view, revision }) =>
      data.frequency_hz.length
        ? envelopeDrawing(data, other, machineLines(asset), view, revision)
        : "The record is too short for a spectrum.",
  },
  {
    key: "turn",
    label: "Average over one turn",
    fetch: (id, query, signal) => api.turn(id, signal),
    draw: (data, other, { revision }) => turnDrawing(data, other, revision),
  },
  {
    key: "cepstrum",
    label: "Cepstrum",
    fetch: (id, query, signal) => api.cepstrum(id, 0.2, signal),
    draw: (data, other, { revision }) => cepstrumDrawing(data, other, revision),
  },
  {
    key: "posterior",
    label: "Posterior over wear depth",
    draw: (data, other, context) => posterior(context),
  },
];

/** The keys of the panes that an address asks for. */
export function shownPanes(query) {
  const keys = (query.show ?? DEFAULT).split(",");
  return PANES.filter(({ key }) => keys.includes(key)).map(({ key }) => key);
}

/** What the shown panes need of a record, as answers of the server or errors, by the panes' keys. */
export async function fetchPanes(id, query, signal) {
  const panes = PANES.filter(({ key, fetch }) => fetch && shownPanes(query).includes(key));
  const answers = await Promise.all(panes.map(({ fetch }) => api.answer(fetch(id, query, signal))));
  return Object.fromEntries(panes.map(({ key }, index) => [key, answers[index]]));
}
