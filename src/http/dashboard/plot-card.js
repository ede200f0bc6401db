// The frame of a plot: heading, legend, tools, the plot itself, what it says in words, and what to show where
// it cannot be drawn.

import { h, setChildren, setText } from "./dom.js";
import { saveCsv } from "./csv.js";
import { savePicture } from "./picture.js";
import { discard, draw, keepFitted, legend } from "./plots.js";
import { inLight } from "./theme.js";

/** A figure that holds one plot. */
export class PlotCard {
  plot = h("div", { class: "plot" });
  /** Holds the plot and what is laid over it. */
  frame = h("div", { class: "plot-frame" }, this.plot);
  tools = h("div", { class: "plot-tools" });
  #title = h("h2");
  #sub = h("p", { class: "muted plot-sub" });
  #legend = h("ul", { class: "legend" });
  #notice = h("p", { class: "notice plot-notice" }, "Loading…");
  #table;
  #filename = "flankwatch";
  #again;
  #csv = h(
    "button",
    {
      type: "button",
      class: "quiet save",
      title: "Save the drawn numbers",
      onclick: () => saveCsv(this.#table(), this.#filename),
    },
    "CSV",
  );
  #png = h(
    "button",
    { type: "button", class: "quiet save", title: "Save the picture", onclick: () => this.#savePicture() },
    "PNG",
  );
  #save = h("span", { class: "plot-save", hidden: true }, this.#csv, this.#png);
  element;

  constructor(kind, title) {
    setText(this.#title, title);
    for (const button of [this.#csv, this.#png])
      button.setAttribute("aria-label", `${title}: save as ${button.textContent}`);
    this.plot.hidden = true;
    keepFitted(this.plot);
    const caption = h(
      "figcaption",
      {},
      h("div", { class: "plot-head" }, this.#title, this.#save, this.tools),
      this.#sub,
    );
    this.element = h(
      "figure",
      { class: `card plot-card plot-${kind}`, "data-plot": kind },
      caption,
      this.#legend,
      this.frame,
      this.#notice,
    );
  }

  #savePicture() {
    const words = { title: this.#title.textContent, sub: this.#sub.textContent };
    if (!this.#again) return savePicture(this.plot, { ...words, legend: this.#legend }, this.#filename);
    return inLight(() => {
      const drawing = this.#again();
      const list = h("ul", {}, legend(drawing.legend ?? []));
      return savePicture(this.plot, { ...words, legend: list }, this.#filename, drawing);
    });
  }

  /**
   * Draws `{ traces, layout, legend, title?, sub, summary, table?, isCompared? }`; `filename` is that of a saved picture or table. `again` gives the same drawing
   * for a picture, which then is in the light colours whatever the theme.
   */
  async show(drawing, filename, again) {
    this.#again = again;
    if (drawing.title) setText(this.#title, drawing.title);
    setText(this.#sub, drawing.sub ?? "");
    setChildren(this.#legend, legend(drawing.legend ?? []));
    this.#notice.hidden = true;
    this.plot.hidden = false;
    this.#table = drawing.table;
    this.#filename = filename.replaceAll(/[^\w.-]+/g, "-");
    this.#csv.hidden = !drawing.table;
    this.#save.hidden = false;
    this.element.toggleAttribute("data-compared", Boolean(drawing.isCompared));
    this.plot.setAttribute("role", "img");
    this.plot.setAttribute("aria-label", drawing.summary);
    await draw(this.plot, drawing.traces, drawing.layout);
  }

  /** Says why there is nothing to draw. */
  say(words) {
    this.plot.hidden = true;
    this.#save.hidden = true;
    this.#notice.hidden = false;
    setText(this.#notice, words);
    setText(this.#sub, "");
    setChildren(this.#legend);
  }

  /** Marks what is shown as that of an earlier record while the next one is fetched. */
  busy(is) {
    this.element.setAttribute("aria-busy", String(is));
  }

  /** Frees the plot. */
  dispose() {
    discard(this.plot);
  }
}
