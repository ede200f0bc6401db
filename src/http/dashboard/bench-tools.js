// The controls of the bench's plots: views, quantity, scale, axis, cut-off, cursors.

import { SCALES } from "./amplitude-scale.js";
import { h } from "./dom.js";
import { PANES } from "./record-panes.js";
import { change, parse } from "./route.js";
import { CUT_OFFS, QUANTITIES, quantityOf } from "./spectrum-quantity.js";
import { FIRST_BEARING, firstCursor } from "./spectrum-tools.js";

/** The views available for records of several machines. */
export const BENCH_PANES = PANES.filter(({ key }) => key !== "posterior");
const FIRST_SHOWN = "spectrum";

/** The keys of the panes selected in the address. */
export function benchPanes({ show = FIRST_SHOWN }) {
  const keys = show.split(",");
  return BENCH_PANES.filter(({ key }) => keys.includes(key)).map(({ key }) => key);
}

function choice(id, label, options, onchange) {
  const select = h(
    "select",
    { id, onchange: () => onchange(select.value) },
    options.map(([value, text]) => h("option", { value }, text)),
  );
  return { select, element: h("label", { class: "field", for: id }, h("span", {}, label), select) };
}

const set =
  (parameter, more = {}) =>
  (value) =>
    change({ [parameter]: value, ...more }, { quiet: true });

/** The toolbar above the plots; its state is in the address. */
export class BenchTools {
  #chips = new Map();
  #quantity = choice(
    "bench-quantity",
    "Quantity",
    Object.entries(QUANTITIES).map(([key, { label }]) => [key === "acceleration" ? "" : key, label]),
    set("quantity"),
  );
  #cut = choice(
    "bench-cut",
    "From",
    CUT_OFFS.map((hz) => [String(hz), `${hz} Hz`]),
    set("cut"),
  );
  #scale = choice("bench-scale", "Amplitude", SCALES, set("scale"));
  #axis = choice(
    "bench-axis",
    "Spectrum axis",
    [
      ["", "Hz"],
      ["orders", "Orders"],
    ],
    set("axis", { band: null, eband: null, cursor: null, ecursor: null }),
  );
  element;

  constructor() {
    const chips = h("div", { class: "chips", role: "group", "aria-label": "Views" });
    for (const { key, label } of BENCH_PANES) {
      const chip = h("button", { type: "button", class: "chip", onclick: () => this.#toggle(key) }, label);
      this.#chips.set(key, chip);
      chips.append(chip);
    }
    this.element = h(
      "div",
      { class: "bench-tools" },
      chips,
      h(
        "div",
        { class: "bench-fields" },
        [this.#axis, this.#quantity, this.#cut, this.#scale].map(({ element }) => element),
      ),
    );
  }

  #toggle(key) {
    const keys = benchPanes(parse(location.hash).query);
    const next = keys.includes(key) ? keys.filter((other) => other !== key) : [...keys, key];
    change({ show: next.join(",") || "none" }, { quiet: true });
  }

  /** Updates from the address. */
  show(query) {
    const shown = benchPanes(query);
    for (const [key, chip] of this.#chips) chip.setAttribute("aria-pressed", String(shown.includes(key)));
    const { key, cut_hz: cut } = quantityOf(query);
    this.#quantity.select.value = key === "acceleration" ? "" : key;
    this.#cut.select.value = String(cut);
    this.#cut.element.hidden = key === "acceleration";
    this.#scale.select.value = SCALES.some(([name]) => name === query.scale) ? query.scale : "";
    this.#axis.select.value = query.axis === "orders" ? "orders" : "";
  }
}

/** The cursor selection of one spectrum, kept in the address as `parameter`. */
export class CursorChoice {
  #parameter;
  #part;
  #spectrum;
  #select;
  #own;
  element;

  /** `part` is the address parameter of the displayed part; null when the cursor does not set it. */
  constructor(parameter, part = null, id = `bench-${parameter}`) {
    [this.#parameter, this.#part] = [parameter, part];
    this.#select = h(
      "select",
      {
        id,
        "aria-label": parameter === "ecursor" ? "Cursor of the envelope" : "Cursor",
        onchange: () => this.#place(this.#select.value),
      },
      [
        ["", "No cursor"],
        ["h", "Harmonics"],
        ["s", "Sidebands"],
        ["b", "Bearing"],
      ].map(([value, text]) => h("option", { value }, text)),
    );
    this.element = this.#select;
  }

  #place(kind) {
    const { query } = parse(location.hash);
    if (kind === "b")
      return change(
        { [this.#parameter]: kind, bearing: query.bearing || this.#own || FIRST_BEARING },
        { quiet: true },
      );
    const first = firstCursor(kind, this.#spectrum, { band: query[this.#part], zoom: "" });
    // Around the mesh line when the whole spectrum is shown: sidebands are too close together there
    const { mesh_frequency_hz: mesh, shaft_speed_hz: shaft } = this.#spectrum;
    const near =
      kind === "s" && this.#part && !query[this.#part] && mesh && shaft
        ? {
            [this.#part]: [mesh - 10 * shaft, mesh + 10 * shaft]
              .map((x) => Number(Math.max(0, x).toPrecision(6)))
              .join("~"),
          }
        : {};
    change({ [this.#parameter]: first.cursor, ...near }, { quiet: true });
  }

  /** Updates from the address and the first spectrum; `own` is the bearing to start with, if any. */
  show(query, spectrum, own) {
    [this.#spectrum, this.#own] = [spectrum, own];
    this.#select.value = (query[this.#parameter] ?? "").slice(0, 1);
    this.#select.disabled = !spectrum;
  }
}
