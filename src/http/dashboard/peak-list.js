// The largest lines of each record in the visible part of a spectrum.

import { BaselineLines, levelWords } from "./baseline-lines.js";
import { amplitudeAt, greatestPeaks } from "./fine-lines.js";
import { decibels, decimals, figure, number, unit } from "./format.js";
import { h, setChildren, setText } from "./dom.js";
import { legend } from "./plots.js";
import { change } from "./route.js";
import { saveCsv } from "./csv.js";

const COUNTS = [5, 10, 20, 50];
const COUNT = 10;
const OF_LINES =
  "Amplitudes of single spectral lines: a tone between two is up to 15 % stronger, as listed for the mesh.";

/** The number of lines set in an address. */
const peakCount = ({ peaks }) => (COUNTS.includes(Number(peaks)) ? Number(peaks) : COUNT);

/** Whether lines are compared at the same order in hertz: the speeds are known, and may have differed. */
const atOrders = (layer, first) =>
  !layer.data.axis && layer.speed && first.speed && layer.start !== first.start;

/**
 * The peaks of every record in a part, `{ layer, x, amplitude, level_db }`, with the level relative to the
 * first record's line at the same order or frequency; null when not all lines are known.
 * @param {import("./layers.js").Layer[]} layers
 * @param {number[]} part
 * @param {number} count
 */
function peaksOf(layers, part, count) {
  const [first] = layers;
  const rows = layers.map((layer) => {
    const peaks = greatestPeaks(layer.data, part, count);
    return peaks?.map(({ x, amplitude }) => {
      const place = atOrders(layer, first) ? (x * first.speed) / layer.speed : x;
      const reference = amplitudeAt(first.data, place);
      const level = reference > 0 && layer !== first ? 20 * Math.log10(amplitude / reference) : null;
      return { layer, x, amplitude, level_db: level };
    });
  });
  return rows.some((each) => !each) ? null : rows.flat();
}

/** The list under a spectrum. */
export class PeakList {
  #baseline = new BaselineLines(() => this.#again());
  #again = () => {};
  #count = h(
    "select",
    {
      "aria-label": "Lines per record",
      id: "bench-peaks",
      onchange: () => change({ peaks: this.#count.value }, { quiet: true }),
    },
    COUNTS.map((count) => h("option", { value: count }, `${count} lines`)),
  );
  #save = h("button", { type: "button", class: "quiet peaks-save", onclick: () => this.#saveRows() }, "CSV");
  #head = h("tr");
  #body = h("tbody");
  #note = h("p", { class: "muted" });
  #columns = [];
  #filename = "peaks";
  #table = h(
    "div",
    { class: "lines-scroll", tabindex: "0", role: "group", "aria-label": "Largest lines" },
    h("table", {}, h("thead", {}, this.#head), this.#body),
  );
  element = h(
    "section",
    { class: "lines peak-list", hidden: true, "aria-label": "Largest lines" },
    h("div", { class: "plot-head" }, h("h3", {}, "Largest lines"), this.#count, this.#save),
    this.#note,
    this.#table,
  );

  constructor() {
    this.#save.setAttribute("aria-label", "Largest lines: save as CSV");
  }

  #saveRows() {
    saveCsv(
      this.#columns.map(([name, values]) => [name, values]),
      this.#filename,
    );
  }

  /** The change of each peak since the baseline of its record's channel. */
  #changes(layers, peaks) {
    return layers.flatMap((layer) => {
      const own = peaks.filter((peak) => peak.layer === layer);
      return this.#baseline.changes(
        layer.data,
        own.map(({ x }) => x),
      );
    });
  }

  /**
   * Shows the peaks of spectra in a part; nothing without spectra.
   * @param {import("./layers.js").Layer[]} layers
   */
  show(layers, part, query, filename) {
    this.#again = () => this.show(layers, part, query, filename);
    this.element.hidden = layers.length === 0;
    if (layers.length === 0) return;
    this.#filename = filename;
    this.#count.value = String(peakCount(query));
    const peaks = peaksOf(layers, part, peakCount(query));
    this.#table.hidden = this.#save.hidden = !peaks;
    if (!peaks) return setText(this.#note, "Too many lines to list: zoom in.");
    const [{ data: first }] = layers;
    const shownUnit = first.unit ? ` (${first.unit})` : "";
    const toHertz = ({ layer: { data }, x }) => x * (data.hertz_per_unit ?? 1);
    const inOrders = ({ layer: { data }, x }) => (data.shaft_speed_hz ? x / data.shaft_speed_hz : null);
    const where = first.axis || layers.some((layer) => atOrders(layer, layers[0])) ? "order" : "frequency";
    const levels =
      layers.length > 1 ? `; levels relative to the first record's line at the same ${where}` : "";
    const range = `${number(part[0], 5)} to ${number(part[1], 5)} ${first.axis ? "orders" : "Hz"}`;
    setText(this.#note, `Range: ${range}${levels}. ${OF_LINES}`);
    const found = this.#changes(layers, peaks);
    const changes = found.some((each) => each !== null) ? found : null;
    this.#columns = [
      ["record", peaks.map(({ layer }) => layer.name)],
      ["frequency_hz", peaks.map((row) => (first.axis && !first.hertz_per_unit ? null : toHertz(row)))],
      ["order", peaks.map(inOrders)],
      [`amplitude_peak${shownUnit}`, peaks.map(({ amplitude }) => amplitude)],
      ["level re first record (dB)", peaks.map(({ level_db: level }) => level)],
      ["level re baseline (dB)", changes],
    ].filter(([, values]) => values);
    const [, hertzOf, orders, amplitudes, toFirst] = this.#columns.map(([, values]) => values);
    setChildren(
      this.#head,
      [
        "Record",
        "Frequency, Hz",
        "Order",
        `Amplitude${unit(first.unit) ? `, ${unit(first.unit)}` : ""}`,
        layers.length > 1 && "dB to first record",
        changes && "dB to baseline",
      ]
        .filter(Boolean)
        .map((name) => h("th", { scope: "col" }, name)),
    );
    setChildren(
      this.#body,
      peaks.map(({ layer }, row) =>
        h(
          "tr",
          {},
          h(
            "th",
            { scope: "row", title: layer.name },
            legend([["line", layer.colour, ""]])[0].firstChild,
            h("span", { class: "spoken" }, layer.name),
          ),
          [
            decimals(hertzOf[row], 2),
            decimals(orders[row], 3),
            figure(amplitudes[row]),
            layers.length > 1 && decibels(toFirst[row]),
            changes && levelWords(changes[row]),
          ]
            .filter((text) => typeof text === "string")
            .map((text) => h("td", {}, text)),
        ),
      ),
    );
  }
}
