// Adding records by hand: upload of a WAV or MCAP file, and replay of a recording in the server's replay folder.

import { h } from "./dom.js";
import { ReplayPanel } from "./replay-panel.js";
import { UploadPanel } from "./upload-panel.js";

/** A dialog with an upload and a replay part. */
export class RecordsDialog {
  #replay;
  element;

  constructor(assetId) {
    this.#replay = new ReplayPanel(assetId);
    const close = h("button", { type: "button", class: "quiet", onclick: () => this.element.close() }, "Close");
    this.element = h(
      "dialog",
      { class: "records", "aria-labelledby": "records-title" },
      h("div", { class: "plot-head" }, h("h2", { id: "records-title" }, `Add records to ${assetId}`), close),
      new UploadPanel(assetId).element,
      this.#replay.element,
    );
  }

  /** Shows the dialog over the page. */
  open() {
    this.element.showModal();
    this.#replay.refresh();
  }

  /** Follows running replays while the dialog is open. */
  tick() {
    if (this.element.open) this.#replay.refresh();
  }

  /** Closes the dialog. */
  dispose() {
    this.element.close();
  }
}
