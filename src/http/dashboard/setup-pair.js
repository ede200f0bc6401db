// The choice of a gear pair: a preset to start from, own data, no pair, or no gears at all.

import { h, setChildren } from "./dom.js";

const NUMBERS = "numbers";
const NONE = "none";
const NO_GEARS = "no-gears";

/** The list of pairs; `onChoice` is called when one is chosen. */
export class PairChoice {
  #presets = [];
  input;
  hint = h(
    "span",
    { class: "muted field-about", id: "setup-pair-about" },
    "Wear needs torque, module and face width. Without them, choose “None: indicators only”.",
  );
  element;

  constructor(onChoice) {
    this.input = h("select", {
      id: "setup-pair",
      "aria-describedby": "setup-pair-about",
      onchange: onChoice,
    });
    this.element = h(
      "div",
      { class: "setup-choice" },
      h(
        "label",
        { class: "field", for: "setup-pair" },
        h("span", {}, "Gear pair, for wear in µm"),
        this.input,
      ),
      this.hint,
    );
    this.offer([]);
  }

  /** Offers presets; the choice stays. */
  offer(presets) {
    const chosen = this.input.value || NUMBERS;
    this.#presets = presets;
    const options = [
      [NUMBERS, "Enter data"],
      ...presets.map(({ name, pair }) => [name, `Start from: ${pair.name || name}`]),
      [NONE, "None: indicators only"],
      [NO_GEARS, "No gears: shaft and bearings only"],
    ];
    setChildren(
      this.input,
      options.map(([value, words]) => h("option", { value }, words)),
    );
    this.input.value = chosen;
  }

  /** The chosen preset, if any. */
  get preset() {
    return this.#presets.find(({ name }) => name === this.input.value);
  }

  /** Shows what kind of machine a description is of. */
  showKind({ gear }) {
    this.input.value = gear?.pair ? NUMBERS : gear ? NONE : NO_GEARS;
  }

  /** Goes back to own data. */
  reset() {
    this.input.value = NUMBERS;
  }

  /** Whether the machine has gears, and whether their pair is described. */
  get shape() {
    const mesh = this.input.value !== NO_GEARS;
    return { mesh, pair: mesh && this.input.value !== NONE };
  }
}
