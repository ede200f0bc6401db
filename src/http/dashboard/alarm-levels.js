// Draggable handles for the levels of an alarm rule on a pane of the trend plot; arrow keys move them too.

import { focusedData, h, setChildren } from "./dom.js";
import { number } from "./format.js";
import { whenActive, activate } from "./plots.js";

const DIGITS = 3; // of a dragged level; more would suggest false precision
const STEPS = 100; // of the arrow keys across the axis

const rounded = (value) => Number(value.toPrecision(DIGITS));

/** The handles on one plot; calls `onLevel(key, value)` when the user moves one. */
export class LevelHandles {
  #plot;
  #onLevel;
  element = h("div", { class: "level-handles" });

  constructor(plot, onLevel) {
    [this.#plot, this.#onLevel] = [plot, onLevel];
    new ResizeObserver(() => this.#place()).observe(plot);
  }

  #levels = [];
  #pane = null;

  /**
   * Shows `levels`, each `{ key, value, label, severity, words }`, on the pane at index `place`; hides the
   * handles when `place` names no pane.
   */
  show(pane, levels) {
    const focused = focusedData("level");
    [this.#pane, this.#levels] = [pane, pane === null ? [] : levels];
    setChildren(
      this.element,
      this.#levels.map((level) => this.#handle(level)),
    );
    this.#place();
    if (pane !== null) activate(this.#plot);
    if (!this.#plot.dataset.handled) {
      this.#plot.dataset.handled = "true";
      whenActive(this.#plot, () => {
        this.#plot.on("plotly_afterplot", () => this.#place());
        this.#place();
      });
    }
    if (focused) this.element.querySelector(`[data-level="${focused}"]`)?.focus();
  }

  #axis() {
    return this.#plot._fullLayout?.[this.#pane ? `yaxis${this.#pane + 1}` : "yaxis"];
  }

  #handle({ key, value, label, severity, words }) {
    const handle = h(
      "button",
      {
        type: "button",
        class: "level-handle",
        role: "slider",
        "data-level": key,
        "data-severity": severity,
        "aria-label": label,
        "aria-orientation": "vertical",
        "aria-valuenow": value,
        "aria-valuetext": words,
      },
      h("span", { "aria-hidden": "true" }, "↕"),
      h("output", {}),
    );
    handle.addEventListener("pointerdown", (event) => this.#drag(event, handle, key));
    handle.addEventListener("keydown", (event) => this.#step(event, key, value));
    return handle;
  }

  #place() {
    const axis = this.#axis();
    for (const handle of this.element.children) {
      const { value } = this.#levels.find(({ key }) => key === handle.dataset.level) ?? {};
      const shown = axis && axis._length && !(axis.type === "log" && value <= 0);
      handle.hidden = !shown;
      if (!shown) continue;
      const [low, high] = axis.range.map((end) => axis.r2d(end));
      handle.setAttribute("aria-valuemin", String(Math.min(low, high)));
      handle.setAttribute("aria-valuemax", String(Math.max(low, high)));
      // A level beyond the axis is shown at its edge, so that it can be dragged into view
      this.#moveTo(handle, Math.min(axis._length, Math.max(0, axis.d2p(value))));
    }
  }

  #moveTo(handle, pixel) {
    const axis = this.#axis();
    const { l: left, r: right } = this.#plot._fullLayout._size;
    handle.style.top = `${axis._offset + pixel}px`;
    handle.style.left = `${left}px`;
    handle.style.right = `${right}px`;
  }

  #drag(event, handle, key) {
    const axis = this.#axis();
    if (!axis || event.button > 0) return;
    event.preventDefault();
    handle.setPointerCapture(event.pointerId);
    handle.classList.add("dragged");
    handle.focus();
    const top = this.#plot.getBoundingClientRect().top + axis._offset;
    const levelAt = (y) => rounded(axis.p2d(Math.min(axis._length, Math.max(0, y - top))));
    const move = ({ clientY }) => {
      this.#moveTo(handle, Math.min(axis._length, Math.max(0, clientY - top)));
      handle.querySelector("output").textContent = number(levelAt(clientY), DIGITS);
    };
    const end = ({ type, clientY }) => {
      handle.classList.remove("dragged");
      handle.removeEventListener("pointermove", move);
      for (const name of ["pointerup", "pointercancel"]) handle.removeEventListener(name, end);
      if (type === "pointerup") this.#onLevel(key, levelAt(clientY));
      else this.#place();
    };
    handle.addEventListener("pointermove", move);
    for (const name of ["pointerup", "pointercancel"]) handle.addEventListener(name, end);
  }

  #step(event, key, value) {
    const direction = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 }[
      event.key
    ];
    const axis = this.#axis();
    if (!direction || !axis) return;
    event.preventDefault();
    this.#onLevel(key, rounded(axis.p2d(axis.d2p(value) - (direction * axis._length) / STEPS)));
  }
}
