// A cursor over a spectrum: equally spaced lines that follow a dragged one. The lines are separate elements
// over the plot, so that dragging does not redraw the plot.

import { BEARING_LINES } from "./bearing-geometry.js";
import { cursorLines, spacingOf } from "./cursor-lines.js";
import { h, setChildren, setText } from "./dom.js";
import { amplitudeAt, isInNoise, peakNear } from "./fine-lines.js";
import { number, unit } from "./format.js";
import { whenActive, activate } from "./plots.js";
import { axisOf } from "./spectrum-plot.js";

const LABEL_PX = 52; // width of a bearing line's label
const SNAP = 4; // lines of the spectrum to each side within which a released cursor snaps to the peak

/** The lines of a cursor over one plot; `onSet` receives the released cursor. */
export class CursorLayer {
  #plot;
  #onSet;
  /** @type {import("./cursor-lines.js").Cursor | null} */
  #cursor = null;
  #spectrum;
  #lines = h("div", { class: "cursor-lines", "aria-hidden": "true" });
  #handles = { base: null, spacing: null };
  #ground;
  #layer;
  readout = h("p", { class: "cursor-readout", "aria-live": "polite", hidden: true });

  /** `isAbove` draws the lines above an opaque plot. */
  constructor({ plot, frame }, onSet, isAbove = false) {
    this.#plot = plot;
    this.#onSet = onSet;
    this.#handles.base = this.#handle("base");
    this.#handles.spacing = this.#handle("spacing");
    // Below the plot: the lines would cover the peaks that they measure
    this.#ground = h("div", { class: "cursor-layer", hidden: true }, this.#lines);
    this.#layer = h(
      "div",
      { class: "cursor-layer", hidden: true },
      this.#handles.base,
      this.#handles.spacing,
    );
    if (isAbove) {
      this.#ground.classList.add("above");
      frame.append(this.#ground);
    } else frame.prepend(this.#ground);
    frame.append(this.#layer); // beside the plot, which screen readers see as one image
  }

  #handle(what) {
    const handle = h("div", { class: "cursor-handle", role: "slider", tabindex: "0" });
    handle.addEventListener("pointerdown", (event) => this.#drag(event, handle, what));
    handle.addEventListener("keydown", (event) => this.#key(event, what));
    return handle;
  }

  /** Shows a cursor over a spectrum, or none. */
  show(cursor, spectrum) {
    this.#cursor = cursor;
    this.#spectrum = spectrum;
    for (const layer of [this.#ground, this.#layer]) layer.hidden = !cursor;
    this.readout.hidden = !cursor;
    if (!cursor) return;
    activate(this.#plot);
    if (!this.#plot.dataset.cursor) {
      this.#plot.dataset.cursor = "true";
      whenActive(this.#plot, () => {
        for (const event of ["plotly_relayout", "plotly_relayouting", "plotly_afterplot"])
          this.#plot.on(event, () => this.#place());
        this.#place();
      });
    }
    this.#place();
  }

  #axis() {
    const layout = this.#plot._fullLayout;
    return layout
      ? {
          axis: layout.xaxis,
          left: layout._size.l,
          top: layout._size.t,
          height: layout._size.h,
          width: layout._size.w,
        }
      : null;
  }

  #place() {
    const frame = this.#cursor && this.#axis();
    if (!frame) return;
    const { axis, left, top, height, width } = frame;
    for (const layer of [this.#ground, this.#layer])
      Object.assign(layer.style, {
        left: `${left}px`,
        top: `${top}px`,
        width: `${width}px`,
        height: `${height}px`,
      });
    const shown = cursorLines(this.#cursor, this.#spectrum.frequency_hz.at(-1));
    const inside = (x) => x >= 0 && x <= width;
    const labelled = shown.length <= 12 || Math.abs(axis.l2p(shown[1].x) - axis.l2p(shown[0].x)) > 26;
    const rows = this.#labelRows(shown, axis);
    setChildren(
      this.#lines,
      shown.map(({ x, label }, index) => {
        const at = axis.l2p(x);
        if (!inside(at)) return null;
        const line = h(
          "span",
          { class: "cursor-line" },
          rows ? rows[index] : labelled || index === 0 ? h("span", {}, label) : null,
        );
        line.style.left = `${at}px`;
        return line;
      }),
    );
    const put = (handle, x, name) => {
      const at = axis.l2p(x);
      handle.hidden = !inside(at);
      handle.style.left = `${at}px`;
      handle.setAttribute("aria-label", name);
      handle.setAttribute("aria-valuenow", String(Number(x.toPrecision(7))));
      handle.setAttribute("aria-valuemin", "0");
      handle.setAttribute("aria-valuemax", String(this.#spectrum.frequency_hz.at(-1)));
      handle.setAttribute("aria-valuetext", axisOf(this.#spectrum).format(x));
    };
    const { kind, base, spacing } = this.#cursor;
    if (kind === "b") this.#handles.base.hidden = true;
    else
      put(
        this.#handles.base,
        base,
        kind === "h" ? "Fundamental of the harmonic cursor" : "Centre of the sideband cursor",
      );
    if (kind === "s") put(this.#handles.spacing, base + spacing, "First upper sideband of the cursor");
    else this.#handles.spacing.hidden = true;
    setText(this.readout, this.#words(shown));
  }

  /** Labels of a bearing's lines, one row per kind, without overlapping ones; null for other cursors. */
  #labelRows(shown, axis) {
    if (this.#cursor.kind !== "b") return null;
    const kinds = BEARING_LINES.map(([, name]) => name);
    const ends = kinds.map(() => -Infinity);
    return shown.map(({ x, label }) => {
      const row = kinds.findIndex((name) => label.endsWith(name));
      const at = axis.l2p(x);
      if (at < ends[row]) return null;
      ends[row] = at + LABEL_PX;
      const words = h("span", {}, label);
      words.style.bottom = `${0.1 + 0.95 * row}rem`;
      return words;
    });
  }

  #words(shown) {
    const { kind, base, spacing } = this.#cursor;
    const spectrum = this.#spectrum;
    const { format } = axisOf(spectrum);
    const amplitudes = shown.map(({ x, label }) => ({ x, label, amplitude: amplitudeAt(spectrum, x) }));
    const noisy = (line) => isInNoise(spectrum, line, spacingOf(this.#cursor));
    // Dragged beyond the fetched lines: the rest is fetched on release
    const value = (amplitude) =>
      amplitudes.some((line) => line.amplitude === undefined)
        ? "…"
        : `${number(amplitude, 3)} ${unit(spectrum.unit)}`.trim();
    if (kind === "b") {
      if (shown.length === 0) return `Bearing ${this.#cursor.name}: lines beyond the spectrum`;
      const first = amplitudes.filter(({ label }) => !label.includes("×"));
      const words = first.map(
        (line) =>
          `${line.label} ${format(line.x)} ${noisy(line) ? "in the noise" : `at ${value(line.amplitude)}`}`,
      );
      const speed = axisOf(spectrum).name === "order" ? "" : `, shaft ${format(base)}`;
      return `Bearing ${this.#cursor.name}${speed}: ${words.join("; ")}`;
    }
    if (kind === "h") {
      if (shown.length === 0) return `Harmonics: ${format(base)} lies beyond the spectrum`;
      const strongest = amplitudes.reduce((a, b) => (b.amplitude > a.amplitude ? b : a));
      const shaft = spectrum.shaft_speed_hz ? ` = ${number(base / spectrum.shaft_speed_hz, 4)} × shaft` : "";
      return `Harmonics: spacing ${format(base)}${shaft}; ${shown.length} lines to ${format(shown.at(-1).x)}; strongest ${strongest.label} at ${value(strongest.amplitude)}`;
    }
    const centre = amplitudes.find(({ label }) => label === "0");
    const all = amplitudes.filter(({ label }) => label !== "0");
    const sides = all.filter((line) => !noisy(line));
    const among = all.every((line) => noisy(line) === undefined) ? "" : ` of ${all.length}`;
    const rss = Math.hypot(...sides.map(({ amplitude }) => amplitude));
    const sum = sides.length ? `, root sum square ${value(rss)}` : "";
    const shaft = spectrum.shaft_speed_hz ? ` = ${number(spacing / spectrum.shaft_speed_hz, 4)} × shaft` : "";
    return `Sidebands: centre ${format(base)} at ${value(centre?.amplitude ?? 0)}${centre && noisy(centre) ? " (in the noise)" : ""}; spacing ${format(spacing)}${shaft}; ${sides.length}${among} lines${among && " above the noise"}${sum}`;
  }

  #move(what, x) {
    const step = this.#spectrum.resolution_hz;
    const cursor = { ...this.#cursor };
    if (what === "base") cursor.base = Math.max(2 * step, x);
    else cursor.spacing = Math.max(2 * step, x - cursor.base);
    this.#cursor = cursor;
    this.#place();
  }

  #drag(event, handle, what) {
    const { axis, left } = this.#axis();
    event.preventDefault();
    event.stopPropagation();
    handle.focus();
    handle.setPointerCapture(event.pointerId);
    const move = (moved) =>
      this.#move(what, axis.p2l(moved.clientX - this.#plot.getBoundingClientRect().left - left));
    const end = () => {
      handle.removeEventListener("pointermove", move);
      const { base, spacing } = this.#cursor;
      const place = what === "base" ? base : base + spacing;
      this.#move(what, peakNear(this.#spectrum, place, SNAP) ?? place);
      this.#onSet(this.#cursor);
    };
    handle.addEventListener("pointermove", move);
    handle.addEventListener("pointerup", end, { once: true });
  }

  #key(event, what) {
    const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    if (!direction) return;
    event.preventDefault();
    const { base, spacing } = this.#cursor;
    const lines = event.shiftKey ? 10 : 1;
    this.#move(
      what,
      (what === "base" ? base : base + spacing) + direction * lines * this.#spectrum.resolution_hz,
    );
    this.#onSet(this.#cursor);
  }
}
