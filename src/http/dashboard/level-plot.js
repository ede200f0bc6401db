// A plot over time with the levels of its alarm rules, which are shown on request and can be dragged.

import { LevelHandles } from "./alarm-levels.js";
import { AlarmRulePanel } from "./alarm-rule-panel.js";
import { h } from "./dom.js";
import { PlotCard } from "./plot-card.js";
import { change } from "./route.js";

/** A plot card with a panel for alarm rules. */
export class LevelPlot extends PlotCard {
  levelsButton = h("button", { type: "button", "aria-expanded": "false" }, "Alarm levels…");
  #panel;
  #handles;

  /**
   * `shownName()` is the name in the address whose levels are shown, `names()` are those that the plot can
   * show. Calls `redraw` when a level changes.
   */
  constructor(kind, title, { redraw, names, shownName, prefix = undefined }) {
    super(kind, title, { rests: true });
    this.#panel = new AlarmRulePanel(redraw, (name) => change({ levels: name }, { quiet: true }), prefix);
    this.#handles = new LevelHandles(this.plot, (key, value) => this.#panel.setLevel(key, value));
    this.levelsButton.addEventListener("click", () => {
      const levels = names().includes(shownName()) ? null : names()[0];
      change({ levels }, { quiet: true });
    });
    this.frame.append(this.#handles.element);
    this.element.append(this.#panel.element);
  }

  /** Shows the panel for the rule `name` if it is among `names`; returns the rules to draw. */
  showPanel({ asset, channel, names, units, name }) {
    const rules = this.#panel.show({ asset, channel, names, units, name });
    this.levelsButton.setAttribute("aria-expanded", String(!this.#panel.element.hidden));
    return rules;
  }

  /** Shows handles for the levels in the pane at index `pane`; none for `null` or while the panel is hidden. */
  showHandles(pane) {
    this.#handles.show(this.#panel.element.hidden ? null : pane, this.#panel.levels());
  }

  /** Releases the plot. */
  dispose() {
    super.dispose();
    this.#panel.dispose();
  }
}
