// Spectra over an asset's life as a heat map; a click on a row opens its record.

import * as api from "./api.js";
import { FramedPage } from "./asset-frame.js";
import { BearingPanel, firstBearing } from "./bearing-panel.js";
import { CursorChoice } from "./bench-tools.js";
import { CursorLayer } from "./cursor.js";
import { cursorOf, formatCursor } from "./cursor-lines.js";
import { withCursor } from "./cursor-picture.js";
import { h, setChildren, setText } from "./dom.js";
import { lifeOrigin, lifeSpan, lifeSubject } from "./plot-subjects.js";
import { PlotCard } from "./plot-card.js";
import { change, go } from "./route.js";
import { latestSpectrum } from "./waterfall-cursor.js";
import { waterfallDrawing } from "./waterfall-plot.js";

const AGAIN_MS = 15_000; // spectra over a life change slowly
const RECORDS = 600;
const MAX_CELLS = 500;
const CELLS_PER_PX = 0.7; // about those beside the axis

/** No more cells than pixels: a narrow plot would drop the lines between them. */
const cellsOf = () => Math.min(MAX_CELLS, Math.floor(CELLS_PER_PX * innerWidth * devicePixelRatio));

/** The waterfall of one asset. */
export class WaterfallPage extends FramedPage {
  #card = new PlotCard("waterfall", "Spectra over time");
  #axis = h(
    "select",
    { id: "waterfall-axis", onchange: () => change({ axis: this.#axis.value, max: null, cursor: null }) },
    h("option", { value: "" }, "Hz"),
    h("option", { value: "orders" }, "Orders"),
  );
  #max = h("input", {
    id: "waterfall-max",
    type: "number",
    min: "0",
    step: "any",
    size: 7,
    placeholder: "whole",
    onchange: () => change({ max: this.#max.value }),
  });
  #floor = h(
    "select",
    { id: "waterfall-floor", onchange: () => change({ floor: this.#floor.value }, { quiet: true }) },
    [
      ["", "60 dB"],
      ["40", "40 dB"],
      ["80", "80 dB"],
    ].map(([value, text]) => h("option", { value }, text)),
  );
  #choice = new CursorChoice("cursor", null, "waterfall-cursor");
  #bearing = new BearingPanel(["cursor"]);
  #cursor;
  #shown;
  #cellAt;
  #label = h("div", { class: "cell-label", hidden: true });
  #asked = "";
  #askedAt = 0;
  #asset;

  constructor(root, route) {
    super(root, route, "waterfall");
    const field = (input, label) => h("label", { class: "check", for: input.id }, label, input);
    this.#card.frame.append(this.#label);
    this.#card.tools.append(
      field(this.#axis, "Axis"),
      field(this.#max, "Up to"),
      field(this.#floor, "Range"),
      this.#choice.element,
    );
    this.#cursor = new CursorLayer(
      this.#card,
      (cursor) => change({ cursor: formatCursor(cursor) }, { quiet: true }),
      true,
    );
    this.#card.frame.before(this.#bearing.element, this.#cursor.readout);
    setChildren(root, this.head.element, this.#card.element);
  }

  /** Reacts to a changed address. */
  update(route) {
    const before = this.query;
    this.query = route.query;
    const isSame = ["axis", "max", "channel", "segment"].every((key) => before[key] === route.query[key]);
    if (isSame && this.#shown) {
      if (before.floor === route.query.floor) this.#showCursor();
      else this.redraw();
      return false;
    }
    this.#card.busy(true);
    return true;
  }

  /** Fetches the data; spectra only when some may have been added. */
  async refresh(signal) {
    const asset = await this.loadAsset(signal);
    if (!asset) return;
    const { axis, max, channel } = this.query;
    const asked = JSON.stringify([axis, max, channel]);
    const same = asset === this.#asset || Date.now() - this.#askedAt < AGAIN_MS;
    if (asked === this.#asked && same) return;
    if (!asset.summary.segments) return this.#card.showNotice("No records yet.");
    const response = await api.settle(
      api.waterfall(this.id, { axis, max, channel, max_records: RECORDS, cells: cellsOf() }, signal),
    );
    [this.#asset, this.#asked, this.#askedAt] = [asset, asked, Date.now()];
    this.#card.busy(false);
    this.#axis.value = axis ?? "";
    // Not while the user is typing: a change of the address would overwrite the input
    if (document.activeElement !== this.#max) this.#max.value = max ?? "";
    if (response instanceof Error) return this.#card.showNotice(response.message);
    this.#shown = response;
    await this.redraw();
  }

  /** Redraws from known data. */
  async redraw() {
    if (!this.#shown) return;
    this.#floor.value = this.query.floor ?? "";
    const [shown, asset, floor] = [this.#shown, this.#asset, Number(this.query.floor) || 60];
    const make = () => waterfallDrawing(shown, floor, this.query.segment, `${this.id} ${this.#asked}`);
    const drawing = await this.#card.show(
      (isPicture) => (isPicture ? withCursor(make(), this.#cursorOf(), shown.position.at(-1), true) : make()),
      `${this.id}-waterfall-${lifeSpan(shown.items)}`,
      () => lifeSubject(asset, shown.channel, shown.items),
      () => lifeOrigin(asset, shown.channel, shown.items),
    );
    if (typeof drawing === "string") return;
    this.#cellAt = drawing.cellAt;
    this.#follow();
    this.#showCursor();
  }

  /** The cursor of the address; null for none. */
  #cursorOf(spectrum = latestSpectrum(this.#shown, this.#asset.gear?.teeth[0])) {
    return spectrum && cursorOf(this.query, spectrum);
  }

  /** Shows the address's cursor over the plot; it reads the latest record. */
  #showCursor() {
    const spectrum = latestSpectrum(this.#shown, this.#asset.gear?.teeth[0]);
    this.#choice.show(this.query, spectrum, firstBearing(this.#asset));
    this.#bearing.element.hidden = this.query.cursor !== "b";
    const shaft = this.#shown.axis === "orders" ? null : (spectrum?.shaft_speed_hz ?? undefined);
    this.#bearing.show(this.query, [this.#asset], shaft);
    this.#cursor.show(this.#cursorOf(spectrum), spectrum);
  }

  /** Describes the cell under the pointer, and opens the record of a clicked one. */
  #follow() {
    const { plot } = this.#card;
    if (plot.dataset.followed) return;
    plot.dataset.followed = "true";
    const cell = ({ points }) =>
      points.map(({ pointNumber: at }) => Array.isArray(at) && this.#cellAt(at)).find(Boolean);
    plot.on("plotly_hover", (event) => {
      const { words } = cell(event) ?? {};
      this.#label.hidden = !words;
      setText(this.#label, words ?? "");
      const { left, right, top } = this.#card.frame.getBoundingClientRect();
      const { clientX: x, clientY: y } = event.event;
      const flipped = x > (left + right) / 2;
      Object.assign(this.#label.style, {
        top: `${y - top}px`,
        left: flipped ? "auto" : `${x - left + 14}px`,
        right: flipped ? `${right - x + 14}px` : "auto",
      });
    });
    plot.on("plotly_unhover", () => (this.#label.hidden = true));
    plot.on("plotly_click", (event) => {
      const { segment } = cell(event) ?? {};
      if (segment) go({ page: "asset", id: this.id, query: { channel: this.query.channel, segment } });
    });
  }

  /** Releases the plot. */
  dispose() {
    this.#card.dispose();
  }
}
