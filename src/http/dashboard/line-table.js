// The lines of a spectrum as numbers: those of the cursor, or else the mesh harmonics and the sidebands that
// are shown.

import { cursorLines } from "./cursor-lines.js";
import { h, setChildren, setText } from "./dom.js";
import { amplitudeAt } from "./fine-lines.js";
import { decibels, number, unit } from "./format.js";
import { axisOf, sidebandsOf } from "./spectrum-plot.js";

const SAME = 2; // lines within which a line is the mesh harmonic

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

/** How far a line has grown since the baseline, in decibels; null where it is no mesh harmonic with one. */
function growth({ mesh_harmonics: harmonics, resolution_hz: step }, { x, amplitude }) {
  const harmonic = harmonics.find(({ frequency_hz: frequency }) => Math.abs(frequency - x) <= SAME * step);
  return harmonic?.baseline_amplitude > 0 && amplitude > 0
    ? 20 * Math.log10(amplitude / harmonic.baseline_amplitude)
    : null;
}

/** The table under a spectrum. */
export class LineTable {
  #summary = h("summary");
  #head = h("tr");
  #body = h("tbody");
  element = h(
    "details",
    { class: "lines", open: true, hidden: true },
    this.#summary,
    h(
      "div",
      { class: "lines-scroll", tabindex: "0", role: "group", "aria-label": "Lines of the spectrum" },
      h("table", {}, h("thead", {}, this.#head), this.#body),
    ),
  );

  /** Shows the lines of a cursor, or those of the mesh where there is none; nothing of a spectrum that is not there. */
  show(spectrum, cursor, { sidebands, zoom }) {
    const usable = spectrum && !(spectrum instanceof Error) && spectrum.frequency_hz.length > 0;
    const rows = !usable
      ? []
      : cursor
        ? cursorLines(cursor, spectrum.frequency_hz.at(-1)).map((line) => ({
            ...line,
            amplitude: amplitudeAt(spectrum, line.x),
          }))
        : meshRows(spectrum, sidebands, zoom);
    this.element.hidden = rows.length === 0;
    if (rows.length === 0) return;
    const grown = rows.map((row) => growth(spectrum, row));
    const { shaft_speed_hz: shaft, unit: unitName } = spectrum;
    const inOrders = axisOf(spectrum).name === "order";
    const columns = [
      ["Line", rows.map(({ label }) => label)],
      shaft && ["Order", rows.map(({ x }) => number(x / shaft, 5))],
      !inOrders && ["Frequency, Hz", rows.map(({ x }) => number(x, 6))],
      [
        `Amplitude${unitName ? `, ${unit(unitName)}` : ""}`,
        rows.map(({ amplitude }) => number(amplitude, 4)),
      ],
      grown.some((change) => change !== null) && ["Since the baseline, dB", grown.map(decibels)],
    ].filter(Boolean);
    setText(this.#summary, cursor ? "Lines of the cursor" : "Lines of the mesh");
    setChildren(
      this.#head,
      columns.map(([name]) => h("th", { scope: "col" }, name)),
    );
    setChildren(
      this.#body,
      rows.map((_, row) =>
        h(
          "tr",
          {},
          columns.map(([, values], column) =>
            h(column ? "td" : "th", column ? {} : { scope: "row" }, values[row]),
          ),
        ),
      ),
    );
  }
}
