// The plots of the bench: each overlays all records in the selected quantity and scale.

import { referenceWords } from "./amplitude-scale.js";
import { BENCH_PANES, benchPanes } from "./bench-tools.js";
import { inLanes } from "./comparison.js";
import { cursorOf } from "./cursor-lines.js";
import { withCursor } from "./cursor-picture.js";
import { thinned } from "./fine-lines.js";
import { number } from "./format.js";
import { GearChoice } from "./gear-choice.js";
import { PeakList } from "./peak-list.js";
import { PlotCard } from "./plot-card.js";
import { onRangeChange, palette } from "./plots.js";
import { formatPart, partOf } from "./record-panes.js";
import { SpectrumAids } from "./spectrum-aids.js";
import { conversionWords, converted, quantityOf } from "./spectrum-quantity.js";

const DRAWN = 6000; // points of a part, more than any screen has columns

/** Address parameters of each spectrum's part and cursor. */
const SPECTRA = {
  spectrum: { part: "band", cursor: "cursor" },
  envelope: { part: "eband", cursor: "ecursor" },
};

/** All plots of the bench; `onRange(parameters)` receives the address parameters of a dragged-out range. */
export class BenchPlots {
  #cards = new Map(BENCH_PANES.map(({ key, label }) => [key, new PlotCard(key, label)]));
  #aids = new Map();
  #peaks = new PeakList();
  #gear = new GearChoice();
  #onRange;
  elements;

  constructor(onRange) {
    this.#onRange = onRange;
    for (const [key, names] of Object.entries(SPECTRA))
      this.#aids.set(key, new SpectrumAids(this.#cards.get(key), names));
    this.#cards.get("spectrum").element.append(this.#peaks.element);
    this.#cards.get("turn").tools.append(this.#gear.element);
    this.elements = [...this.#cards.values()].map(({ element }) => element);
  }

  /** Marks the plots as loading. */
  busy(is) {
    for (const card of this.#cards.values()) card.busy(is);
  }

  /** Draws the panes selected in the address for records `{ segment, asset, colour, name, panes }`. */
  async show(records, query, isWanted, isLoading) {
    const keys = benchPanes(query);
    const hasGears = records.length === 0 || records.some(({ asset }) => asset.gear);
    this.#gear.show(query, sameTeeth(records), hasGears);
    for (const [key, card] of this.#cards) card.element.hidden = !isWanted || !keys.includes(key);
    await Promise.all(
      BENCH_PANES.filter(({ key }) => keys.includes(key)).map((pane) =>
        this.#show(pane, records, query, isLoading),
      ),
    );
    for (const [key, parameter] of [
      ["waveform", "part"],
      ...Object.entries(SPECTRA).map(([k, v]) => [k, v.part]),
    ])
      onRangeChange(this.#cards.get(key).plot, (range) => this.#onRange({ [parameter]: formatPart(range) }));
  }

  /** @param {(typeof BENCH_PANES)[number]} pane */
  async #show({ key, draw }, records, query, isLoading) {
    const card = this.#cards.get(key);
    const known = records.filter(({ panes }) => panes && panes[key] !== undefined);
    const usable = known.filter(({ panes }) => !(panes[key] instanceof Error) && hasLines(panes[key]));
    const refused = known.filter((record) => !usable.includes(record));
    if (usable.length === 0) {
      this.#aids.get(key)?.show(query, []);
      if (key === "spectrum") this.#peaks.show([], [0, 0], query, "");
      const [first] = refused;
      return card.showNotice(
        first
          ? `${first.name}: ${first.panes[key].message ?? "too short for a spectrum"}.`
          : isLoading || records.length
            ? "Loading…"
            : "None of the records can be displayed.",
      );
    }
    const whole = layersOf(key, usable, query);
    const names = SPECTRA[key];
    const part = names ? partOf(query[names.part]) : null;
    const end = names ? Math.max(...whole.map(({ data }) => data.frequency_hz.at(-1))) : 0;
    const context = contextOf(key, usable, whole, query, part);
    const missing = refused.map(
      ({ name, panes }) => ` Not drawn: ${name}, ${panes[key].message ?? "too short"}.`,
    );
    const cursor = names ? cursorOf(query, whole[0].data, names.cursor) : null;
    const motion = key === "waveform" ? motionWords(usable, query) : "";
    const make = () => {
      const coloured = coloursOf(usable, whole);
      const drawn =
        names && query.scale !== "change"
          ? coloured.map((layer) => ({ ...layer, data: thinned(layer.data, part ?? [0, end], DRAWN) }))
          : coloured;
      const drawing = draw(drawn, context);
      if (typeof drawing === "string") return drawing;
      const sub = `${drawing.sub}${motion}${missing.join("")}`;
      // A waveform with many samples is an area that hides those behind it
      return key === "waveform" && drawn.length > 1
        ? { ...inLanes(drawing, drawn), sub }
        : { ...drawing, sub, traces: firstOnTop(drawing) };
    };
    // The page overlays the cursor's lines on the plot; a picture contains them
    const drawing = await card.show(
      (isPicture) => (isPicture ? withCursor(make(), cursor, end) : make()),
      `bench-${key}-${whole[0].name}`,
      () => (usable.length > 1 ? `${usable.length} records overlaid` : usable[0].name),
      () => usable.map(({ name, segment }) => ["Record", `${name}, recorded in ${segment.unit}`]),
    );
    if (typeof drawing === "string") return;
    this.#aids.get(key)?.show(query, whole);
    if (key === "spectrum")
      this.#peaks.show(
        whole,
        part ?? [0, end],
        query,
        `bench-lines-${whole[0].name}`.replaceAll(/[^\w.-]+/g, "-"),
      );
  }

  /** Frees the plots. */
  dispose() {
    for (const card of this.#cards.values()) card.dispose();
  }
}

/** Draws the first record on top of the others, and its marks on top of all. */
const firstOnTop = ({ traces, others }) => [...others, ...traces];

const hasLines = (data) => !("frequency_hz" in data) || data.frequency_hz.length > 0;

/** The tooth counts shared by all records, or none when they differ. */
function sameTeeth(records) {
  const all = records.map(({ asset }) => asset.gear?.teeth);
  return all.every((teeth) => String(teeth) === String(all[0])) ? all[0] : undefined;
}

/** The records of a pane as drawing layers; spectra are converted to the selected quantity. */
function layersOf(key, records, query) {
  const quantity = quantityOf(query);
  return records.map(({ panes, segment, colour, name }) => {
    const own = panes[key];
    // By the axis of the data: data for a newly selected axis may still be loading
    const hertz = own.axis ? segment.shaft_speed?.shaft_speed_hz : undefined;
    const placed = hertz ? { ...own, hertz_per_unit: hertz } : own;
    const data = key === "spectrum" ? converted(placed, quantity, hertz ?? 1) : placed;
    const { shaft_speed: speed, start_time: start } = segment;
    const known = speed && !speed.doubt ? speed.shaft_speed_hz : undefined;
    const words = { name, pointed: `${name}, `, prefix: `${name}: ` };
    return { data, colour, ...words, isNamed: true, speed: known, start };
  });
}

/** Layers in the colours of the current theme. */
function coloursOf(records, layers) {
  const { records: colours } = palette();
  return layers.map((layer, n) => ({ ...layer, colour: colours[records[n].place] }));
}

/** Describes the conversion of records to the selected quantity. */
function motionWords(records, query) {
  return conversionWords(
    records.map(({ segment }) => segment.unit),
    quantityOf(query),
  );
}

function contextOf(key, records, layers, query, part) {
  const [{ asset, segment }] = records;
  const duration = Math.max(...records.map(({ segment: each }) => each.samples / each.sample_rate_hz));
  const notes = [];
  if (key === "spectrum") notes.push(motionWords(records, query));
  if (key === "envelope" && layers.length > 1) notes.push(" All envelopes use the band of the first record.");
  if (query.scale === "db") notes.push(` ${referenceWords(layers[0].data.unit)}.`);
  if (["spectrum", "envelope"].includes(key) && layers.length > 1 && !layers[0].data.axis) {
    const speeds = records.map(({ segment: each }) => each.shaft_speed?.shaft_speed_hz);
    const [low, high] = [Math.min(...speeds), Math.max(...speeds)];
    if (high > 1.002 * low)
      notes.push(
        ` Shaft speeds range from ${number(low)} to ${number(high)} Hz: use an order axis to align the lines.`,
      );
  }
  const view = { scale: query.scale ?? "", part, envelopePart: part, note: notes.join("") };
  const shown = records.map(({ id }) => id).join(" ");
  const revision = `${shown} ${query.axis ?? ""} ${query.quantity ?? ""}`;
  return { asset, segment, query, duration, view, revision };
}
