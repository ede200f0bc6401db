// The frame of a plot: heading, legend, tools, plot, description, and a notice when it cannot be drawn.

import { h, setChildren, setText } from "./dom.js";
import { saveCsv } from "./csv.js";
import { savePicture } from "./picture.js";
import { discard, draw, keepFitted, legend, moveLast, activate } from "./plots.js";
import { inLight } from "./theme.js";

/** Stands in for a plot that is being fetched. */
export const LOADING = "Loading…";

/** A figure that holds one plot. */
export class PlotCard {
  plot = h("div", { class: "plot" });
  /** Holds the plot and its overlays. */
  frame = h("div", { class: "plot-frame" }, this.plot);
  tools = h("div", { class: "plot-tools" });
  #title = h("h2");
  #sub = h("p", { class: "muted plot-sub" });
  #legend = h("ul", { class: "legend" });
  #notice = h("p", { class: "notice plot-notice waiting" }, LOADING);
  #table;
  #filename = "flankwatch";
  #make;
  #frame;
  #subject;
  #facts;
  #rests;
  #csv = h(
    "button",
    {
      type: "button",
      class: "quiet save",
      title: "Save the data as CSV",
      onclick: () => saveCsv(this.#table(), this.#filename, this.#factLines()),
    },
    "CSV",
  );
  #png = h(
    "button",
    { type: "button", class: "quiet save", title: "Save as PNG", onclick: () => this.#savePicture() },
    "PNG",
  );
  #save = h("span", { class: "plot-save", hidden: true }, this.#csv, this.#png);
  element;

  /** A card that `rests` shows its plot without Plotly until somebody turns to it. */
  constructor(kind, title, { rests = false } = {}) {
    this.#rests = rests;
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
    // Whoever comes by keyboard may be on the way to a handle over the plot
    this.element.addEventListener("focusin", ({ target }) => {
      if (target instanceof Element && target.matches(":focus-visible")) activate(this.plot);
    });
  }

  #factLines() {
    return [["Plot", this.#title.textContent], ...(this.#facts?.() ?? [["Subject", this.#subject()]])];
  }

  #savePicture() {
    return inLight(() => {
      const drawing = this.#make(true);
      const words = {
        title: this.#title.textContent,
        subject: this.#subject(),
        sub: this.#sub.textContent,
        legend: h("ul", {}, legend(drawing.legend ?? [])),
      };
      return savePicture(this.plot, words, this.#filename, drawing);
    });
  }

  /**
   * Draws what `make` returns: `{ traces, layout, legend, title?, sub, summary, table?, isCompared?, lanes? }`, or a
   * text when there is nothing to draw; returns it. `make(true)` is called again for a picture, in the light
   * theme. `filename` is used for saved pictures and tables; `subject` returns the caption of a picture, `facts`
   * the lines before a table, each `[name, value]`, by default the caption.
   * Drawings with the same `frame` differ only in their last trace.
   */
  async show(make, filename, subject, facts) {
    const drawing = make(false);
    if (typeof drawing === "string") {
      this.showNotice(drawing);
      return drawing;
    }
    this.#make = make;
    this.#subject = subject;
    this.#facts = facts;
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
    this.plot.style.setProperty("--lanes", drawing.lanes ?? 1);
    this.plot.setAttribute("role", "img");
    this.plot.setAttribute("aria-label", drawing.summary);
    const { traces, layout, frame } = drawing;
    const isSame = frame !== undefined && frame === this.#frame;
    this.#frame = frame;
    if (!isSame || !moveLast(this.plot, traces.at(-1)))
      await draw(this.plot, traces, layout, { rests: this.#rests });
    return drawing;
  }

  /** Shows why there is nothing to draw. */
  showNotice(words) {
    this.#frame = undefined;
    this.plot.hidden = true;
    this.#save.hidden = true;
    this.#notice.hidden = false;
    setText(this.#notice, words);
    this.#notice.classList.toggle("waiting", words === LOADING);
    setText(this.#sub, "");
    setChildren(this.#legend);
  }

  /** Marks the plot as outdated while the next record is loading. */
  busy(is) {
    this.element.setAttribute("aria-busy", String(is));
  }

  /** Releases the plot. */
  dispose() {
    discard(this.plot);
  }
}
