// The plots of the bench: each draws all records over one another, in the quantity and on the scale chosen.

import { referenceWords } from "./amplitude-scale.js";
import { BENCH_PANES, benchPanes, CursorChoice } from "./bench-tools.js";
import { CursorLayer } from "./cursor.js";
import { cursorLines, cursorOf, formatCursor } from "./cursor-lines.js";
import { thinned } from "./fine-lines.js";
import { number } from "./format.js";
import { GearChoice } from "./gear-choice.js";
import { LineTable } from "./line-table.js";
import { PeakList } from "./peak-list.js";
import { PlotCard } from "./plot-card.js";
import { onRangeChange, palette, verticalLine } from "./plots.js";
import { formatPart, partOf } from "./record-panes.js";
import { change } from "./route.js";
import { conversionWords, converted, quantityOf } from "./spectrum-quantity.js";

const DRAWN = 6000; // points of a part, more than any screen has columns

/** What a spectrum's part and cursor are called in an address. */
const SPECTRA = {
  spectrum: { part: "band", cursor: "cursor" },
  envelope: { part: "eband", cursor: "ecursor" },
};

/** What is known of spectra beside the curve: a cursor, the lines that it reads. */
class SpectrumAids {
  #names;
  #card;
  #choice;
  #layer;
  table = new LineTable();

  constructor(card, names) {
    [this.#card, this.#names] = [card, names];
    this.#choice = new CursorChoice(names.cursor, names.part);
    card.tools.append(this.#choice.element);
    this.#layer = new CursorLayer(card, (cursor) =>
      change({ [names.cursor]: formatCursor(cursor) }, { quiet: true }),
    );
    card.frame.before(this.#layer.readout);
    card.element.append(this.table.element);
  }

  show(query, layers) {
    const [first, ...others] = layers;
    const cursor = first ? cursorOf(query, first.data, this.#names.cursor) : null;
    this.#choice.show(query, first?.data);
    this.#layer.show(cursor, first?.data);
    const further = {
      first,
      layers: others,
      cursors: others.map(({ data }) => cursorOf(query, data, this.#names.cursor) ?? cursor),
    };
    // the mesh's lines are told by the spectrum itself
    const told = cursor || this.#names.cursor === "cursor" ? first?.data : null;
    this.table.show(told, cursor, { sidebands: false, zoom: "" }, further);
  }
}

/** A drawing with a cursor's lines, which otherwise lie over the plot. */
function withCursor(drawing, cursor, end) {
  if (!cursor) return drawing;
  const { "series-4": ink, surface } = palette();
  const lines = cursorLines(cursor, end);
  const { shapes = [], annotations = [] } = drawing.layout;
  return {
    ...drawing,
    layout: {
      ...drawing.layout,
      shapes: [...shapes, ...lines.map(({ x }) => verticalLine(x, ink))],
      annotations: [
        ...annotations,
        ...lines.map(({ x, label: text }) => ({
          x,
          yref: "paper",
          y: 0,
          yanchor: "bottom",
          xanchor: "left",
          text,
          showarrow: false,
          bgcolor: surface,
          font: { color: ink, size: 10 },
        })),
      ],
    },
  };
}

/** All plots of the bench; `onRange(parameters)` gets what the address is to say of a range that was dragged out. */
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

  /** Marks the plots as being fetched. */
  busy(is) {
    for (const card of this.#cards.values()) card.busy(is);
  }

  /** Draws the panes that the address asks for, of records with `{ segment, asset, colour, name, panes }`; nothing where none is wanted. */
  async show(records, query, isWanted, isLoading) {
    const keys = benchPanes(query);
    this.#gear.show(query, sameTeeth(records));
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
      return card.say(
        first
          ? `${first.name}: ${first.panes[key].message ?? "too short for a spectrum"}.`
          : isLoading || records.length
            ? "Loading…"
            : "None of the records can be shown.",
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
      return typeof drawing === "string"
        ? drawing
        : {
            ...drawing,
            sub: `${drawing.sub}${motion}${missing.join("")}`,
            // the first record over the others, and its marks over all
            traces: [...drawing.others, ...drawing.traces],
          };
    };
    // the page has a cursor's lines over the plot, a picture in it
    const drawing = await card.show(
      (isPicture) => (isPicture ? withCursor(make(), cursor, end) : make()),
      `bench-${key}-${whole[0].name}`,
      () => (usable.length > 1 ? `${usable.length} records over one another` : usable[0].name),
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

const hasLines = (data) => !("frequency_hz" in data) || data.frequency_hz.length > 0;

/** The tooth numbers of records that all have the same, else none. */
function sameTeeth(records) {
  const all = records.map(({ asset }) => asset.gear?.teeth);
  return all.every((teeth) => String(teeth) === String(all[0])) ? all[0] : undefined;
}

/** The records of a pane as the layers of its drawing, spectra in the quantity that is chosen. */
function layersOf(key, records, query) {
  const quantity = quantityOf(query);
  return records.map(({ panes, segment, colour, name }) => {
    const own = panes[key];
    // by what the data are over: those over the axis that was just chosen are still on their way
    const hertz = own.axis ? segment.shaft_speed?.shaft_speed_hz : undefined;
    const placed = hertz ? { ...own, hertz_per_unit: hertz } : own;
    const data = key === "spectrum" ? converted(placed, quantity, hertz ?? 1) : placed;
    return { data, colour, name, pointed: `${name}, `, prefix: `${name}: `, isNamed: true };
  });
}

/** Layers in the colours of the theme that is drawn in. */
function coloursOf(records, layers) {
  const { records: colours } = palette();
  return layers.map((layer, n) => ({ ...layer, colour: colours[records[n].place] }));
}

/** What is done to records to show them as the quantity that is chosen. */
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
  if (key === "envelope" && layers.length > 1)
    notes.push(" Every record's envelope is taken in the first one's band.");
  if (query.scale === "db") notes.push(` ${referenceWords(layers[0].data.unit)}.`);
  if (["spectrum", "envelope"].includes(key) && layers.length > 1 && !layers[0].data.axis) {
    const speeds = records.map(({ segment: each }) => each.shaft_speed?.shaft_speed_hz);
    const [low, high] = [Math.min(...speeds), Math.max(...speeds)];
    if (high > 1.002 * low)
      notes.push(
        ` Shaft speeds differ, ${number(low)} to ${number(high)} Hz: over orders the lines coincide.`,
      );
  }
  const view = { scale: query.scale ?? "", part, envelopePart: part, note: notes.join("") };
  const shown = records.map(({ id }) => id).join(" ");
  const revision = `${shown} ${query.axis ?? ""} ${query.quantity ?? ""}`;
  return { asset, segment, query, duration, view, revision };
}
