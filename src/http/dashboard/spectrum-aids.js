// The cursor of one spectrum: its selection, its lines over the plot, and the table of its readings.

import { CursorChoice } from "./bench-tools.js";
import { CursorLayer } from "./cursor.js";
import { cursorOf, formatCursor } from "./cursor-lines.js";
import { LineTable } from "./line-table.js";
import { change } from "./route.js";

/** The cursor of a spectrum and the fine lines that it reads. */
export class SpectrumAids {
  #names;
  #choice;
  #layer;
  table = new LineTable();

  constructor(card, names) {
    this.#names = names;
    this.#choice = new CursorChoice(names.cursor, names.part);
    card.tools.append(this.#choice.element);
    this.#layer = new CursorLayer(card, (cursor) =>
      change({ [names.cursor]: formatCursor(cursor) }, { quiet: true }),
    );
    card.frame.before(this.#layer.readout);
    card.element.append(this.table.element);
  }

  /** Shows the cursor of an address over records; `own` is the bearing that its selection starts with. */
  show(query, layers, own) {
    const [first, ...others] = layers;
    const cursor = first ? cursorOf(query, first.data, this.#names.cursor) : null;
    this.#choice.show(query, first?.data, own);
    this.#layer.show(cursor, first?.data);
    const further = {
      first,
      layers: others,
      cursors: others.map(({ data }) => cursorOf(query, data, this.#names.cursor) ?? cursor),
    };
    // The spectrum marks the mesh lines itself
    const marked = cursor || this.#names.cursor === "cursor" ? first?.data : null;
    this.table.show(marked, cursor, { sidebands: false, zoom: "" }, further);
  }
}
