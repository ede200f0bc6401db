// Selects the bearing whose lines a cursor marks: one of an asset, a known one, or a custom geometry.

import {
  BEARING_LINES,
  formatGeometry,
  formatOrders,
  geometryFault,
  KNOWN_BEARINGS,
  parseBearing,
} from "./bearing-geometry.js";
import { h, setChildren, setText } from "./dom.js";
import { hertz, number } from "./format.js";
import { change, parse } from "./route.js";

const FIELDS = [
  ["elements", "Rolling elements", "1"],
  ["roller", "Rolling element diameter, mm", "any"],
  ["pitch", "Pitch diameter, mm", "any"],
  ["contact", "Contact angle, °", "any"],
];
const FIRST = { elements: 9, roller: 7.94, pitch: 39.04, contact: 0 };

const option = (value, text) => h("option", { value }, text);

/** The bearings of assets, each `[value, text]`. */
const ownBearings = (assets) =>
  assets.flatMap((asset) =>
    Object.entries(asset.summary?.bearing_orders ?? {}).map(([name, orders]) => [
      formatOrders(`${asset.id} ${name}`, orders),
      `${asset.id}: ${name}`,
    ]),
  );

/** The first bearing of an asset as an address has it; undefined without one. */
export const firstBearing = (asset) => ownBearings([asset])[0]?.[0];

/** The selection of a bearing and its shaft speed, kept in the address. */
export class BearingPanel {
  #bearing = h("select", { id: "bench-bearing", onchange: () => this.#choose(this.#bearing.value) });
  #speed = h("input", {
    id: "bench-speed",
    type: "number",
    min: 0,
    step: "any",
    onchange: () =>
      change({ speed: Number(this.#speed.value) > 0 ? this.#speed.value : null }, { quiet: true }),
  });
  #inputs = new Map(
    FIELDS.map(([key, , step]) => [
      key,
      h("input", { id: `bench-${key}`, type: "number", min: 0, step, onchange: () => this.#describe() }),
    ]),
  );
  #geometry = h("div", { class: "bench-geometry", hidden: true });
  #fault = h("p", { class: "result", "data-kind": "bad", role: "status" });
  #orders = h("p", { class: "muted" });
  #options = "";
  #cursors;
  #speedField;
  element;

  /** `cursors` are the address parameters of the cursors that show the lines. */
  constructor(cursors = ["cursor", "ecursor"]) {
    this.#cursors = cursors;
    const field = (input, text) => h("label", { class: "field", for: input.id }, h("span", {}, text), input);
    this.#speedField = field(this.#speed, "Shaft speed, Hz");
    this.#geometry.append(...FIELDS.map(([key, text]) => field(this.#inputs.get(key), text)));
    this.element = h(
      "div",
      { class: "bench-bearing" },
      h("div", { class: "bench-fields" }, field(this.#bearing, "Bearing"), this.#speedField, this.#geometry),
      this.#fault,
      this.#orders,
    );
  }

  /** Selecting a bearing shows its lines, unless another cursor is shown. */
  #choose(value) {
    const bearing = value === "g" ? formatGeometry(FIRST) : value;
    const { query } = parse(location.hash);
    const shown = (kind) => (bearing ? kind || "b" : kind === "b" ? null : kind);
    const cursors = this.#cursors.map((name) => [name, shown(query[name])]);
    change({ bearing, ...Object.fromEntries(cursors) }, { quiet: true });
  }

  #describe() {
    const geometry = Object.fromEntries(
      [...this.#inputs].map(([key, { value }]) => [key, value === "" ? NaN : Number(value)]),
    );
    const fault = geometryFault(/** @type {any} */ (geometry));
    setText(this.#fault, fault);
    if (!fault) change({ bearing: formatGeometry(/** @type {any} */ (geometry)) }, { quiet: true });
  }

  #offer(assets, chosen) {
    const own = ownBearings(assets);
    const kept = parseBearing(chosen);
    // From a link whose asset has changed or is not on the bench
    if (kept?.key.startsWith("o~") && !own.some(([value]) => value === chosen)) own.push([chosen, kept.name]);
    const options = JSON.stringify(own);
    if (options === this.#options) return;
    this.#options = options;
    setChildren(
      this.#bearing,
      option("", "None"),
      own.length
        ? h(
            "optgroup",
            { label: "From the assets" },
            own.map(([value, text]) => option(value, text)),
          )
        : null,
      h(
        "optgroup",
        { label: "Known bearings" },
        KNOWN_BEARINGS.map(({ key, name }) => option(key, name)),
      ),
      option("g", "Custom geometry…"),
    );
  }

  /**
   * Updates from the address; `assets` are those of the records, `shaft` is the first record's shaft speed in
   * Hz, null where lines are over orders and need none.
   */
  show(query, assets, shaft) {
    this.#speedField.hidden = shaft === null;
    this.#offer(assets, query.bearing);
    const bearing = parseBearing(query.bearing);
    this.#bearing.value = bearing?.key ?? "";
    this.#geometry.hidden = bearing?.key !== "g";
    if (document.activeElement !== this.#speed) this.#speed.value = query.speed ?? "";
    this.#speed.placeholder = shaft ? number(shaft, 5) : "unknown";
    if (bearing?.geometry)
      for (const [key, input] of this.#inputs)
        if (document.activeElement !== input) input.value = String(bearing.geometry[key]);
    const speed = shaft === null ? null : Number(query.speed) || shaft;
    const line = ([key, name]) =>
      `${name} ${number(bearing.orders[key], 5)} ×${speed ? ` = ${hertz(bearing.orders[key] * speed)}` : ""}`;
    setText(
      this.#orders,
      bearing
        ? `${BEARING_LINES.map(line).join(", ")}. Outer race fixed, no slip.${speed || shaft === null ? "" : " Enter the shaft speed: no record has one."}`
        : "",
    );
  }
}
