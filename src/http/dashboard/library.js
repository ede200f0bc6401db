// One library: its grid of wear states with their figures, and the mesh of the selected state.

import * as api from "./api.js";
import { crumbs } from "./asset-frame.js";
import { h, setChildren, tableHead } from "./dom.js";
import { depth, figure, indicatorName } from "./format.js";
import { drawPair } from "./gear-drawing.js";
import { stiffnessDrawing, transmissionDrawing, umPerRadian } from "./mesh-plots.js";
import { PlotCard } from "./plot-card.js";
import { onPointClick, palette } from "./plots.js";
import { change } from "./route.js";

/** @type {[string, string, (row: any, umPerRad: number) => any][]} */
const COLUMNS = [
  ["index", "State", (row) => row.index],
  ["wear_um", "Wear (µm)", (row) => depth(row.wear_um)],
  [
    "stiffness_mean_n_per_m",
    "Mean stiffness (N/\u2060µm)",
    (row) => figure(row.stiffness_mean_n_per_m * 1e-6),
  ],
  ["stiffness_min_n_per_m", "Minimum (N/\u2060µm)", (row) => figure(row.stiffness_min_n_per_m * 1e-6)],
  ["stiffness_max_n_per_m", "Maximum (N/\u2060µm)", (row) => figure(row.stiffness_max_n_per_m * 1e-6)],
  [
    "uste_peak_to_peak_rad",
    "Transmission error, peak to peak (µm)",
    (row, scale) => figure(row.uste_peak_to_peak_rad < 1e-12 ? 0 : row.uste_peak_to_peak_rad * scale),
  ],
  ["rms", "RMS (m/s²)", (row) => figure(row.rms)],
  ["kurtosis", "Kurtosis", (row) => figure(row.kurtosis)],
  ["omx", "OMX (m/s²)", (row) => figure(row.omx)],
];
const CHOICES = ["rms", "kurtosis", "omx", "crest_factor", "mesh_2", "mesh_3", "mesh_4", "mesh_5"];

/** Draws one indicator over the grid. */
function gridDrawing(rows, name, chosen, revision) {
  const colour = palette();
  const x = rows.map((row) => row.wear_um);
  return {
    traces: [
      {
        x,
        y: rows.map((row) => row[name]),
        mode: "lines+markers",
        line: { color: colour.accent, width: 1.5 },
        marker: {
          size: 6,
          color: rows.map((row) => (row.index === chosen ? colour.reference : colour.accent)),
        },
        customdata: rows.map((row) => String(row.index)),
        hovertemplate: "state %{customdata}, %{x:.0f} µm: %{y:.4g}<extra></extra>",
      },
    ],
    legend: [],
    table: () => Object.keys(rows[0]).map((key) => [key, rows.map((row) => row[key])]),
    sub: "Model prediction at each wear depth, without transmission path or noise. Click a point to select a state.",
    summary: `${indicatorName(name)} over ${rows.length} wear states.`,
    layout: {
      uirevision: `${revision} ${name}`,
      hovermode: "closest",
      xaxis: { title: { text: "Wear depth (µm)" } },
      yaxis: {
        title: {
          text: `${indicatorName(name)} (${["kurtosis", "crest_factor"].includes(name) ? "–" : "m/s²"})`,
        },
      },
    },
  };
}

/** The page of one library. */
export class LibraryPage {
  #id;
  #query;
  #root;
  #data;
  #title = h("h1", {}, "Library");
  #sub = h("p", { class: "muted" });
  #gears = h("div", { class: "gear-drawing" });
  #name = h(
    "select",
    {
      id: "library-indicator",
      "aria-label": "Indicator",
      onchange: () => change({ indicator: this.#name.value }, { quiet: true }),
    },
    CHOICES.map((name) => h("option", { value: name }, indicatorName(name))),
  );
  #curve = new PlotCard("grid", "Indicators vs wear depth");
  #stiffness = new PlotCard("stiffness", "Mesh stiffness");
  #transmission = new PlotCard("transmission", "Unloaded transmission error");
  #table = h("div", {
    class: "card table-card state-table",
    tabindex: "0",
    role: "region",
    "aria-label": "States of the library",
  });

  constructor(root, route) {
    this.#root = root;
    this.#id = route.id;
    this.#query = route.query;
    this.#curve.tools.append(this.#name);
    const pair = h("section", { class: "card" }, h("h2", {}, "Gear pair"), this.#gears);
    const grid = h(
      "div",
      { class: "asset-grid" },
      h("div", { class: "column" }, pair, this.#curve.element),
      h("div", { class: "column" }, this.#stiffness.element, this.#transmission.element),
    );
    setChildren(
      root,
      h("header", { class: "asset-header" }, crumbs(["#/libraries", "Libraries"]), this.#title, this.#sub),
      grid,
      this.#table,
    );
    document.title = "Library · flankwatch";
  }

  /** Reacts to a changed address. */
  update(route) {
    const before = this.#query;
    this.#query = route.query;
    if (before.state !== route.query.state) return true;
    this.redraw();
    return false;
  }

  #chosen(rows) {
    const asked = Number(this.#query.state ?? Math.round((rows.length - 1) / 2));
    return rows.find((row) => row.index === asked) ?? rows[0];
  }

  /** Fetches the library, which never changes, and the selected state. */
  async refresh(signal) {
    if (this.#data && this.#data.state.index === this.#chosen(this.#data.rows).index) return;
    const library = this.#data?.library ?? (await api.settle(api.library(this.#id, signal)));
    if (library instanceof Error)
      return setChildren(
        this.#root,
        h("h1", {}, this.#id),
        h("p", { class: "notice" }, `${library.message}. `, h("a", { href: "#/libraries" }, "All libraries")),
      );
    const rows = this.#data?.rows ?? (await api.libraryStates(this.#id, signal)).items;
    const index = this.#chosen(rows).index;
    const [state, unworn] = await Promise.all([
      api.libraryState(this.#id, index, signal),
      api.libraryState(this.#id, 0, signal),
    ]);
    this.#data = { library, rows, state, unworn };
    await this.redraw();
  }

  /** Redraws from known data. */
  async redraw() {
    if (!this.#data) return;
    const { library, rows, state, unworn } = this.#data;
    const name = CHOICES.includes(this.#query.indicator) ? this.#query.indicator : "rms";
    this.#name.value = name;
    this.#title.textContent = library.pair_name || "Library";
    this.#sub.textContent = `${library.states} states from unworn to ${depth(library.max_wear_um)} µm, ${library.contact} contact, ${library.pair.wear.shape} wear; library ${library.id}.`;
    document.title = `${library.pair_name || library.id} · flankwatch`;
    drawPair(this.#gears, library.pair.geometry);
    this.#fillTable(rows, state.index, umPerRadian(library.pair.geometry));
    const subject = () => `Simulated: ${library.pair_name || "gear pair"}, library ${library.id}`;
    await Promise.all([
      this.#curve.show(
        () => gridDrawing(rows, name, state.index, this.#id),
        `library-${this.#id}-grid`,
        subject,
      ),
      this.#stiffness.show(
        () => stiffnessDrawing(state, unworn, this.#id),
        `library-${this.#id}-stiffness-${state.index}`,
        subject,
      ),
      this.#transmission.show(
        () => transmissionDrawing(state, unworn, library.pair.geometry, this.#id),
        `library-${this.#id}-transmission-error-${state.index}`,
        subject,
      ),
    ]);
    onPointClick(this.#curve.plot, (index) => change({ state: index }, { quiet: true }));
  }

  #fillTable(rows, chosen, scale) {
    const row = (state) =>
      h(
        "tr",
        { "aria-current": state.index === chosen ? "true" : null },
        COLUMNS.map(([key, , words]) =>
          key === "index"
            ? h(
                "th",
                { scope: "row" },
                h(
                  "button",
                  {
                    type: "button",
                    class: "quiet",
                    onclick: () => change({ state: String(state.index) }, { quiet: true }),
                    "aria-label": `Show state ${state.index}`,
                  },
                  String(state.index),
                ),
              )
            : h("td", {}, String(words(state, scale))),
        ),
      );
    setChildren(
      this.#table,
      h("table", {}, tableHead(COLUMNS.map(([, head]) => head)), h("tbody", {}, rows.map(row))),
    );
  }

  /** Releases the plots. */
  dispose() {
    for (const card of [this.#curve, this.#stiffness, this.#transmission]) card.dispose();
  }
}
