// Progress and result of one upload of the import panel.

import { h, setChildren, setText } from "./dom.js";
import { bytes } from "./format.js";

/** Progress and result of one upload. */
export class UploadProgress {
  #file;
  #words = h("p", {});
  #bar = h("progress", { max: 1, value: 0, hidden: true });
  element;

  constructor(file) {
    this.#file = file;
    this.#bar.setAttribute("aria-label", `Upload of ${file.name}`);
    setText(this.#words, `${file.name}: waiting.`);
    this.element = h("div", { class: "result", role: "status" }, this.#words, this.#bar);
  }

  begin() {
    this.#bar.hidden = false;
    setText(this.#words, `Uploading ${this.#file.name}, ${bytes(this.#file.size)}…`);
  }

  sent(share) {
    if (share < 1) return (this.#bar.value = share);
    // All bytes are sent; the response arrives once every record is analysed and stored
    this.#bar.removeAttribute("value");
    setText(this.#words, `${this.#file.name}: uploaded, analysing…`);
  }

  end(kind, words) {
    this.element.dataset.kind = kind;
    setChildren(this.element, ...words.map((text) => h("p", {}, text)));
  }
}
