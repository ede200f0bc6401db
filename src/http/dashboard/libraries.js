// The libraries of simulated wear states on this server.

import * as api from "./api.js";
import { h, setChildren, tableHead } from "./dom.js";
import { depth, hertz } from "./format.js";
import { format } from "./route.js";

/** The list of libraries. */
export class LibrariesPage {
  #list = h("div", { class: "card table-card" }, h("p", { class: "notice" }, "Loading the libraries…"));
  #shown;

  constructor(root) {
    document.title = "Libraries · flankwatch";
    const words =
      "Each library holds simulated wear states of one gear pair, from unworn to the maximum depth. Record features are compared with them.";
    setChildren(root, h("h1", {}, "Libraries"), h("p", { class: "muted" }, words), this.#list);
  }

  update() {
    return true;
  }

  /** Fetches the libraries and shows what changed. */
  async refresh(signal) {
    const response = await api.libraries(signal);
    if (response === this.#shown) return;
    this.#shown = response;
    if (response.items.length === 0)
      return setChildren(
        this.#list,
        h(
          "p",
          { class: "notice" },
          "No libraries yet. The server builds one for each asset with a gear pair.",
        ),
      );
    const rows = response.items.map((library) =>
      h(
        "tr",
        {},
        h(
          "th",
          { scope: "row" },
          h("a", { href: format({ page: "library", id: library.id }) }, library.pair_name || library.id),
          h("span", { class: "muted id" }, library.id),
        ),
        h("td", {}, String(library.states)),
        h("td", {}, `0 to ${depth(library.max_wear_um)} µm`),
        h("td", {}, library.contact),
        h("td", {}, `${library.seconds} s at ${hertz(library.sample_rate_hz)}`),
        h("td", {}, `features “${library.preprocessing}”, model version ${library.model_version}`),
      ),
    );
    const heads = ["Gear pair", "States", "Wear", "Contact rule", "Simulated", "Computed with"];
    setChildren(this.#list, h("table", {}, tableHead(heads), h("tbody", {}, rows)));
  }
}
