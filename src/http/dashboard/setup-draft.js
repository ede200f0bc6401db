// What is typed for a new asset, kept in the tab until it is created: a reload or the way back loses nothing.

import { h } from "./dom.js";

const KEY = "flankwatch-new-asset";

const inputsOf = (form) => [...form.querySelectorAll("input[id], select[id], textarea[id]")];
const valueOf = (input) => (input.type === "checkbox" ? input.checked : input.value);

/** The draft of a form; `onDiscard` is called when the user starts over. */
export class SetupDraft {
  #form;
  element;

  constructor(form, onDiscard) {
    this.#form = form;
    this.element = h(
      "p",
      { class: "result setup-restored", role: "status", hidden: true },
      "These are your entries from before: the asset is not created yet. ",
      h(
        "button",
        {
          type: "button",
          class: "quiet",
          onclick: () => {
            this.clear();
            onDiscard();
          },
        },
        "Start over",
      ),
    );
  }

  /** Keeps the entered description, and the fields as they are: an empty one may follow from others. */
  keep(spec) {
    const values = Object.fromEntries(inputsOf(this.#form).map((input) => [input.id, valueOf(input)]));
    try {
      sessionStorage.setItem(KEY, JSON.stringify({ spec, values }));
    } catch {
      // Without storage a reload empties the form
    }
  }

  /** The kept description; null when there is none. */
  get spec() {
    return read()?.spec ?? null;
  }

  /** Restores the fields of a form that shows the kept description. */
  restore() {
    const { values } = read() ?? { values: {} };
    for (const input of inputsOf(this.#form)) {
      const value = values[input.id];
      if (input.type === "checkbox") input.checked = Boolean(value);
      else if (typeof value === "string") input.value = value;
    }
    this.element.hidden = false;
  }

  /** Forgets what was entered. */
  clear() {
    this.element.hidden = true;
    try {
      sessionStorage.removeItem(KEY);
    } catch {
      // Nothing is kept
    }
  }
}

function read() {
  try {
    const draft = JSON.parse(sessionStorage.getItem(KEY) ?? "null");
    return draft?.spec && draft.values ? draft : null;
  } catch {
    return null;
  }
}
