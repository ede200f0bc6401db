// The controls of a spectrum: axis, zoom, cursors, sidebands, and logarithmic scale.

import { formatCursor } from "./cursor-lines.js";
import { h, setChildren } from "./dom.js";
import { partOf } from "./record-panes.js";
import { change, parse } from "./route.js";
import { zoomRange } from "./spectrum-plot.js";

/** The bearing that a cursor starts with when the asset has none. */
export const FIRST_BEARING = "6205";

function check(id, label, onchange) {
  const input = h("input", { type: "checkbox", id, onchange: () => onchange(input.checked) });
  return { input, element: h("label", { class: "check", for: id }, input, label) };
}

function choice(id, label, options, onchange) {
  const select = h(
    "select",
    { id, "aria-label": label, onchange: () => onchange(select.value) },
    options.map(([value, text]) => h("option", { value }, text)),
  );
  return select;
}

/**
 * The initial position of a cursor as address parameters: on the visible mesh line, with sidebands spaced by
 * the shaft speed.
 * @param {string} kind
 * @param {any} spectrum
 * @param {{ band?: string, zoom?: string }} query
 */
export function firstCursor(kind, spectrum, { band: part, zoom: near }) {
  const { mesh_frequency_hz: mesh, shaft_speed_hz: shaft, frequency_hz: x } = spectrum;
  const end = x.at(-1);
  if (kind !== "s") return { cursor: kind && formatCursor({ kind, base: mesh ?? end / 10 }) };
  const band = partOf(part);
  const zoom = band ? null : near || (mesh ? "1" : null);
  const [from, to] = band ?? zoomRange(spectrum, zoom) ?? [0, end];
  const middle = (from + to) / 2;
  // Of several visible mesh lines the one nearest to the middle
  const nearest = mesh ? Math.max(1, Math.round(middle / mesh)) * mesh : middle;
  const base = nearest > from && nearest < to ? nearest : middle;
  const spacing = Math.min(shaft ?? Infinity, (to - base) / 2);
  return { cursor: formatCursor({ kind, base, spacing }), ...(zoom && { zoom }) };
}

/** The tools of the spectrum's card; their state is in the address. */
export class SpectrumTools {
  #spectrum;
  #own;
  #axis = choice(
    "spectrum-axis",
    "Spectrum axis",
    [
      ["", "Hz"],
      ["orders", "Orders"],
    ],
    (axis) => change({ axis, cursor: null, band: null }, { quiet: true }),
  );
  #cursor = choice(
    "spectrum-cursor",
    "Cursor",
    [
      ["", "No cursor"],
      ["h", "Harmonics"],
      ["s", "Sidebands"],
      ["b", "Bearing"],
    ],
    (kind) => this.#place(kind),
  );
  #zoom = choice("spectrum-zoom", "Zoom", [["", "Whole spectrum"]], (zoom) =>
    change({ zoom, band: null }, { quiet: true }),
  );
  #sidebands = check("sidebands", "Sidebands", (on) => this.#showSidebands(on));
  #log = check("spectrum-log", "Log", (on) => change({ slog: on ? "1" : null }, { quiet: true }));
  elements = [this.#axis, this.#zoom, this.#cursor, this.#sidebands.element, this.#log.element];

  /** Sidebands are indistinguishable in the whole spectrum, so enabling them zooms to the first mesh line. */
  #showSidebands(on) {
    const nearer = on && !this.#zoom.value && !parse(location.hash).query.band;
    change({ side: on ? "1" : null, zoom: nearer ? "1" : this.#zoom.value }, { quiet: true });
  }

  #place(kind) {
    // Uses the address, not the drawing: another choice may precede the response to the first
    const { query } = parse(location.hash);
    const placed =
      kind === "b"
        ? { cursor: kind, bearing: query.bearing || this.#own || FIRST_BEARING }
        : firstCursor(kind, this.#spectrum, query);
    change(placed, { quiet: true });
  }

  /**
   * Updates from the address and the spectrum; returns the view they define. `own` is the bearing that a cursor
   * starts with, if any. A machine without a mesh has no lines to zoom to.
   */
  update(spectrum, query, own, hasMesh) {
    this.#own = own;
    const usable = spectrum && !(spectrum instanceof Error);
    this.#spectrum = spectrum;
    const orders = usable ? spectrum.mesh_harmonics.map(({ order }) => order) : [];
    if (this.#zoom.dataset.choices !== String(orders)) {
      this.#zoom.dataset.choices = String(orders);
      const choices = [
        ["", "Whole spectrum"],
        ...orders.map((order) => [String(order), `Around ${order}× mesh`]),
      ];
      setChildren(
        this.#zoom,
        choices.map(([value, label]) => h("option", { value }, label)),
      );
    }
    const zoom = query.zoom ?? "";
    this.#zoom.value = orders.includes(Number(zoom)) ? zoom : "";
    this.#axis.value = query.axis === "orders" ? "orders" : "";
    this.#cursor.value = (query.cursor ?? "").slice(0, 1);
    this.#cursor.disabled = !usable;
    for (const control of [this.#zoom, this.#sidebands.input]) control.disabled = orders.length === 0;
    for (const element of [this.#zoom, this.#sidebands.element]) element.hidden = !hasMesh;
    const view = { scale: query.slog === "1" ? "log" : "", sidebands: query.side === "1", zoom };
    this.#log.input.checked = view.scale === "log";
    this.#sidebands.input.checked = view.sidebands;
    return view;
  }
}
