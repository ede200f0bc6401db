// Dialog to add records: the import panel, and replay of a recording in the server's replay folder.

import { h } from "./dom.js";
import { ImportDesk } from "./import-desk.js";
import { ReplayPanel } from "./replay-panel.js";

/** A dialog with an upload and a replay section. */
export class RecordsDialog {
  #replay;
  #upload;
  element;

  constructor(assetId) {
    this.#upload = new ImportDesk(assetId);
    this.#replay = new ReplayPanel(assetId);
    const close = h(
      "button",
      { type: "button", class: "quiet", onclick: () => this.element.close() },
      "Close",
    );
    this.element = h(
      "dialog",
      { class: "records", "aria-labelledby": "records-title" },
      h("div", { class: "plot-head" }, h("h2", { id: "records-title" }, `Add records to ${assetId}`), close),
      this.#upload.element,
      this.#replay.element,
    );
  }

  /** Shows the dialog. */
  open() {
    if (!this.element.open) this.element.showModal();
    this.#replay.refresh();
  }

  /** Opens with dropped files and lists them. */
  take(files) {
    this.open();
    return this.#upload.take(files);
  }

  /** Updates running replays while the dialog is open. */
  tick() {
    if (this.element.open) this.#replay.refresh();
  }

  /** Closes the dialog. */
  dispose() {
    this.element.close();
  }
}
