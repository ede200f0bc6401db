// Spectral lines as a table: those of the cursor, or else the visible mesh harmonics and sidebands.

import { BaselineLines, levelWords } from "./baseline-lines.js";
import { cursorLines, spacingOf } from "./cursor-lines.js";
import { h, setChildren, setText } from "./dom.js";
import { amplitudeAt, isInNoise, NOISE_WORDS } from "./fine-lines.js";
import { decibels, decimals, figure, unit } from "./format.js";
import { legend } from "./plots.js";
import { axisOf, sidebandsOf } from "./spectrum-plot.js";

const SAME = 2; // lines within which a line counts as the mesh harmonic

function meshRows(spectrum, sidebands, zoom) {
  return spectrum.mesh_harmonics.flatMap(({ order, frequency_hz: x, amplitude }) => {
    const line = { label: `mesh ${order}×`, x, amplitude };
    if (!sidebands || order !== Number(zoom)) return [line];
    const beside = sidebandsOf(x, spectrum.shaft_speed_hz).map(({ x: place, label }) => ({
      label: `${order}× ${label}`,
      x: place,
      amplitude: amplitudeAt(spectrum, place),
    }));
    return [...beside, line].sort((a, b) => a.x - b.x);
  });
}

/** The lines of a cursor in one spectrum. */
function cursorRows(spectrum, cursor) {
  return cursorLines(cursor, spectrum.frequency_hz.at(-1)).map((line) => ({
    ...line,
    amplitude: amplitudeAt(spectrum, line.x),
  }));
}

const change = (amplitude, first) => (amplitude > 0 && first > 0 ? 20 * Math.log10(amplitude / first) : null);

/** The lines of a cursor, or those of the mesh without one; `noisy` are those in the noise. */
function rowsOf(spectrum, cursor, { sidebands, zoom }) {
  const rows = cursor ? cursorRows(spectrum, cursor) : meshRows(spectrum, sidebands, zoom);
  const spacing = cursor ? spacingOf(cursor) : spectrum.shaft_speed_hz;
  return rows.map((row) => ({ ...row, noisy: isInNoise(spectrum, row, spacing) }));
}

/** An amplitude as text, in brackets if it is in the noise. */
const amplitudeWords = (amplitude, noisy) => (noisy ? `(${figure(amplitude)})` : figure(amplitude));

/** A heading in the colour of its record. */
const recordHeading = ({ data, colour, name }) => [
  legend([["line", colour, ""]])[0].firstChild,
  h("span", { class: "spoken" }, `${name}, amplitude`),
  ` ${unit(data.unit)}`,
];

/** The amplitudes of further records at the rows of the first, and their ratio to it. */
function furtherColumns(layers, cursors, rows, view) {
  return layers.flatMap((layer, n) => {
    const own = new Map(rowsOf(layer.data, cursors[n], view).map((row) => [row.label, row]));
    const lines = rows.map(({ label }) => own.get(label));
    return [
      [recordHeading(layer), lines.map((line) => amplitudeWords(line?.amplitude, line?.noisy))],
      ["dB", lines.map((line, row) => decibels(change(line?.amplitude, rows[row].amplitude)))],
    ];
  });
}

/** The change of a mesh harmonic since the baseline in dB; null for other lines, or without a baseline. */
function growth({ mesh_harmonics: harmonics, resolution_hz: step }, { x, amplitude }) {
  const harmonic = harmonics.find(({ frequency_hz: frequency }) => Math.abs(frequency - x) <= SAME * step);
  return harmonic?.baseline_amplitude > 0 && amplitude > 0
    ? 20 * Math.log10(amplitude / harmonic.baseline_amplitude)
    : null;
}

/** The table under a spectrum. */
export class LineTable {
  #baseline = new BaselineLines(() => this.#again());
  #again = () => {};
  #summary = h("summary");
  #head = h("tr");
  #body = h("tbody");
  #note = h("p", { class: "muted" }, `(…) ${NOISE_WORDS}`);
  element = h(
    "details",
    { class: "lines", open: true, hidden: true },
    this.#summary,
    h(
      "div",
      { class: "lines-scroll", tabindex: "0", role: "group", "aria-label": "Spectral lines" },
      h("table", {}, h("thead", {}, this.#head), this.#body),
    ),
    this.#note,
  );

  /** The changes of lines since the baseline; those of other lines than mesh harmonics are requested. */
  #changes(spectrum, rows) {
    const known = rows.map((row) => growth(spectrum, row));
    const { axis, band_hz: band, mesh_harmonics: harmonics } = spectrum;
    const hasNone =
      !axis && !band && harmonics.length && !harmonics.some((each) => each.baseline_amplitude > 0);
    if (hasNone) return known; // the baseline is still being collected
    const others = rows.filter((_, row) => known[row] === null);
    const changes = this.#baseline.changes(
      spectrum,
      others.map(({ x }) => x),
    );
    return rows.map((row, n) => known[n] ?? changes[others.indexOf(row)]);
  }

  /**
   * Shows the lines of a cursor, or those of the mesh without one; nothing when the spectrum is missing.
   * `further` are other records with their cursors, whose amplitudes are shown beside those of the `first`.
   * @param {{ first?: import("./layers.js").Layer, layers: import("./layers.js").Layer[], cursors: import("./cursor-lines.js").Cursor[] }} [further]
   */
  show(spectrum, cursor, view, further = { layers: [], cursors: [] }) {
    this.#again = () => this.show(spectrum, cursor, view, further);
    const usable = spectrum && !(spectrum instanceof Error) && spectrum.frequency_hz.length > 0;
    const rows = usable ? rowsOf(spectrum, cursor, view) : [];
    this.element.hidden = rows.length === 0;
    if (rows.length === 0) return;
    const grown = this.#changes(spectrum, rows);
    const { shaft_speed_hz: shaft, unit: unitName } = spectrum;
    const inOrders = axisOf(spectrum).name === "order";
    const columns = [
      ["Line", rows.map(({ label }) => label)],
      shaft && ["Order", rows.map(({ x }) => decimals(x / shaft, 3))],
      !inOrders && ["Frequency, Hz", rows.map(({ x }) => decimals(x, 2))],
      [
        further.layers.length
          ? recordHeading(further.first)
          : `Amplitude${unit(unitName) ? `, ${unit(unitName)}` : ""}`,
        rows.map(({ amplitude, noisy }) => amplitudeWords(amplitude, noisy)),
      ],
      ...furtherColumns(further.layers, further.cursors, rows, view),
      grown.some((each) => each != null) && ["dB to baseline", grown.map(levelWords)],
    ].filter(Boolean);
    this.#note.hidden = !columns.some(([, values]) => values.some((text) => text.startsWith("(")));
    setText(this.#summary, cursor ? "Cursor lines" : "Mesh lines");
    setChildren(
      this.#head,
      columns.map(([name]) => h("th", { scope: "col" }, name)),
    );
    setChildren(
      this.#body,
      rows.map(({ noisy }, row) =>
        h(
          "tr",
          noisy ? { class: "in-noise", title: NOISE_WORDS } : {},
          columns.map(([, values], column) =>
            h(column ? "td" : "th", column ? {} : { scope: "row" }, values[row]),
          ),
        ),
      ),
    );
  }
}
