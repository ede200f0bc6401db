// Indicators over time on the page of an asset: which are shown, how, and their alarm levels.

import { h, setOptions } from "./dom.js";
import { indicatorName } from "./format.js";
import { LevelPlot } from "./level-plot.js";
import { lifeOrigin, lifeSpan, lifeSubject } from "./plot-subjects.js";
import { change } from "./route.js";
import { chosenPanes, PANES, trendDrawing } from "./trend-plot.js";
import { timeOf, timeRange } from "./wear-plot.js";

/** The plot of indicators, a pane for each. */
export class TrendsCard extends LevelPlot {
  #query;
  #hasMesh = true;
  #chips = new Map();
  #log = h("input", {
    type: "checkbox",
    id: "trend-log",
    onchange: () => change({ log: this.#log.checked ? "1" : null }, { quiet: true }),
  });
  #more = h("select", {
    id: "trend-more",
    hidden: true,
    "aria-label": "Add indicator",
    onchange: () => this.#togglePane(this.#more.value),
  });
  #bins = h(
    "select",
    {
      id: "trend-bins",
      "aria-label": "Colour by operating point",
      onchange: () => change({ bins: this.#bins.value }, { quiet: true }),
    },
    [
      ["", "No colouring"],
      ["speed", "By speed"],
      ["torque", "By torque"],
      ["own", "By operating bin"],
    ].map(([value, text]) => h("option", { value }, text)),
  );

  /** `query()` returns the parameters in the address. Calls `redraw` when a level changes. */
  constructor(query, redraw) {
    const names = () => this.#levelNames();
    super("trends", "Indicator trends", { redraw, names, shownName: () => query().levels });
    this.#query = query;
    for (const { key, label } of PANES)
      this.#chips.set(
        key,
        h(
          "button",
          { type: "button", class: "chip", "data-key": key, onclick: () => this.#togglePane(key) },
          label,
        ),
      );
    this.tools.append(
      h("div", { class: "chips", role: "group", "aria-label": "Indicators" }, ...this.#chips.values()),
      this.#more,
      this.#bins,
      h("label", { class: "check", for: "trend-log" }, this.#log, "Log"),
      this.levelsButton,
    );
  }

  /** Hides what needs a mesh if there is none. */
  setMesh(hasMesh) {
    this.#hasMesh = hasMesh;
    for (const { key, ofMesh } of PANES) this.#chips.get(key).hidden = Boolean(ofMesh) && !hasMesh;
  }

  /** The selected panes. */
  chosen() {
    return chosenPanes(this.#query().trend, this.#hasMesh);
  }

  #togglePane(key) {
    const keys = this.chosen().map((pane) => pane.key);
    const next = keys.includes(key) ? keys.filter((other) => other !== key) : [...keys, key];
    if (next.length) change({ trend: next.join(",") }, { quiet: true });
  }

  /** The displayed indicators for which alarm levels can be set. */
  #levelNames() {
    return this.chosen()
      .filter((pane) => pane.names.length === 1)
      .map((pane) => pane.names[0]);
  }

  /** Draws the trends, or says why there is nothing to draw. */
  async update({ asset, trend, history, latest, events }, selected, revision) {
    const { names, panes, response: indicators, bins, others } = trend;
    const query = this.#query();
    this.#bins.value = query.bins ?? "";
    this.#bins.querySelector("[value=own]").hidden = !asset.operating_bins?.length;
    this.#offer(others, panes);
    const logarithmic = query.log === "1";
    this.#log.checked = logarithmic;
    for (const [key, chip] of this.#chips)
      chip.setAttribute("aria-pressed", String(panes.some((pane) => pane.key === key)));
    if (!indicators) return this.showNotice("This record does not have these indicators.");
    if (indicators instanceof Error) return this.showNotice(indicators.message);
    const range = timeOf(query.time) ?? timeRange(history, latest);
    this.plot.style.setProperty("--panes", panes.length);
    const levelNames = this.#levelNames();
    const { channel, units, items } = indicators;
    const rules = this.showPanel({ asset, channel, names: levelNames, units, name: query.levels });
    this.levelsButton.hidden = levelNames.length === 0;
    const { velocity_limits_mm_per_s: limits } = asset.summary;
    const how = { revision, bins, events, range, rules, limits };
    const pane = panes.findIndex((each) => each.names.length === 1 && each.names[0] === query.levels);
    await this.show(
      () => trendDrawing(indicators, panes, names, logarithmic, selected, how),
      `${asset.id}-trends-${lifeSpan(items)}`,
      () => lifeSubject(asset, channel, items),
      () => lifeOrigin(asset, channel, items),
    );
    this.showHandles(pane < 0 ? null : pane);
  }

  /** The indicators without a chip of their own; selecting a selected one removes it. */
  #offer(others, panes) {
    const chosen = panes.map((pane) => pane.key);
    const options = [
      ["", "More…"],
      ...others.map((name) => [name, `${chosen.includes(name) ? "✓ " : ""}${indicatorName(name)}`]),
    ];
    setOptions(this.#more, options);
    this.#more.value = "";
    this.#more.hidden = others.length === 0;
  }
}
