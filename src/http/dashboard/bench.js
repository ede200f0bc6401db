// The analyst's bench: overlays records of any assets and channels, with cursors, a list of lines, and audio
// playback.

import * as api from "./api.js";
import { crumbs } from "./asset-frame.js";
import { BearingPanel } from "./bearing-panel.js";
import { BenchList } from "./bench-list.js";
import { BenchPlots } from "./bench-plots.js";
import { saveBench, loadBench, recordsOf } from "./bench-records.js";
import { BenchTools, benchPanes } from "./bench-tools.js";
import { h, setChildren } from "./dom.js";
import { Listening, SPEEDS } from "./listening.js";
import { recordSubject } from "./plot-subjects.js";
import { palette } from "./plots.js";
import { angleAbsence } from "./record-angle.js";
import { fetchPanes } from "./record-panes.js";
import { change, format } from "./route.js";
import { motionOf } from "./spectrum-quantity.js";

const POINTS = 200_000; // of a spectrum: every line of all but very long records

/**
 * Address parameters that determine what is fetched, and those that fetch more spectral lines than one response
 * holds.
 */
const REFETCHED = ["records", "show", "axis", "part", "gear", "quantity", "cut"];
const DETAILED = ["band", "eband", "cursor", "ecursor", "bearing", "speed"];

/** The view of an address; without records, the bench as last seen in this tab. */
function restored(query) {
  const kept = loadBench();
  if (query.records || !kept.records) return query;
  const whole = { ...kept, times: query.times };
  history.replaceState(null, "", format({ page: "bench", query: whole }));
  return whole;
}

/** The page on which records are compared. */
export class BenchPage {
  #query;
  #known = new Map(); // id → { segment, asset, panes }
  #key = "";
  #list;
  #tools = new BenchTools();
  #bearing = new BearingPanel();
  #plots = new BenchPlots((parameters) => change(parameters, { quiet: true }));
  #listening = new Listening(() => this.#showList());
  #speed = h(
    "select",
    { id: "bench-playback", onchange: () => (this.#listening.speed = Number(this.#speed.value)) },
    SPEEDS.map((times) => h("option", { value: times, selected: times === 1 }, `${times} ×`)),
  );
  #controls;

  constructor(root, route) {
    this.#query = restored(route.query);
    this.#list = new BenchList((id) => this.#listen(id));
    this.#controls = h(
      "section",
      { class: "card bench-controls", "aria-label": "Display options" },
      this.#tools.element,
      this.#bearing.element,
      h(
        "div",
        { class: "bench-fields" },
        h("label", { class: "field", for: "bench-playback" }, h("span", {}, "Playback speed"), this.#speed),
        h(
          "p",
          { class: "muted bench-note" },
          "“Listen” loops up to 30 s from the start of a record, normalised to the same peak. The level is not calibrated.",
        ),
      ),
    );
    setChildren(
      root,
      h(
        "header",
        { class: "asset-header" },
        crumbs(["#/", "Fleet"]),
        h("h1", {}, "Bench"),
        h("p", { class: "muted" }, "Compare records of any assets and channels."),
      ),
      h("div", { class: "bench" }, this.#list.element, this.#controls, ...this.#plots.elements),
    );
    document.title = "Bench · flankwatch";
    this.#draw();
  }

  /** Reacts to a changed address. */
  update(route) {
    const before = this.#query;
    this.#query = route.query;
    const changed = (names) => names.some((name) => before[name] !== route.query[name]);
    if (this.#listening.id && !recordsOf(route.query).includes(this.#listening.id)) this.#listening.stop();
    this.#draw();
    if (changed(["axis", "part", "gear"])) this.#plots.busy(true);
    return changed(REFETCHED) || (changed(DETAILED) && this.#isReduced());
  }

  #isReduced() {
    return [...this.#known.values()].some(({ panes }) => panes.spectrum?.reduced || panes.envelope?.reduced);
  }

  /** Fetches the records and shows what changed. */
  async refresh(signal) {
    const query = this.#query;
    const ids = recordsOf(query);
    const key = JSON.stringify(
      Object.entries(query).filter(([name]) => [...REFETCHED, ...DETAILED].includes(name)),
    );
    if (key === this.#key) return;
    this.#list.offerAssets(await api.assets(signal));
    const options = { points: POINTS, envelopeOverOrders: query.axis === "orders" };
    const asked = { ...query, show: benchPanes(query).join(",") || "none", zoom: undefined, near: undefined };
    const [first, ...others] = ids;
    const fetched = first ? [await this.#fetch(first, asked, signal, options)] : [];
    // Otherwise each record would select its own band and be drawn as another quantity
    const band = fetched[0]?.panes.envelope?.band_hz;
    fetched.push(
      ...(await Promise.all(others.map((id) => this.#fetch(id, asked, signal, { ...options, band })))),
    );
    this.#known = new Map(ids.map((id, n) => [id, fetched[n]]));
    this.#key = key;
    await this.#draw();
    this.#plots.busy(false);
  }

  /** @returns {Promise<{ segment: any, asset: any, panes: Record<string, any> }>} */
  async #fetch(id, query, signal, options) {
    const segment = await api.settle(api.segment(id, signal));
    if (segment instanceof Error) return { segment, asset: null, panes: {} };
    const owner = api.settle(api.asset(segment.asset_id, signal));
    const [asset, panes] = await Promise.all([
      owner,
      fetchPanes(id, query, signal, {
        ...options,
        motion: motionOf(query, segment.unit),
        noAngle: async () => angleAbsence(segment, await owner),
      }),
    ]);
    return { segment, asset, panes };
  }

  #records() {
    const colours = palette().records;
    return recordsOf(this.#query).map((id, place) => {
      const { segment, asset, panes } = this.#known.get(id) ?? {};
      const isKnown = segment && !(segment instanceof Error) && !(asset instanceof Error);
      const name = isKnown ? recordSubject(segment, asset) : `Record ${id}`;
      return { id, place, segment, asset, panes, colour: colours[place], name };
    });
  }

  #showList() {
    this.#list.show(this.#records(), this.#listening.id);
  }

  async #draw() {
    saveBench(this.#query);
    const records = this.#records();
    const usable = records.filter(
      ({ segment, asset }) => segment && !(segment instanceof Error) && asset && !(asset instanceof Error),
    );
    this.#showList();
    this.#tools.show(this.#query);
    const assets = [...new Map(usable.map(({ asset }) => [asset.id, asset])).values()];
    this.#bearing.show(this.#query, assets, usable[0]?.segment.shaft_speed?.shaft_speed_hz);
    this.#controls.hidden = records.length === 0;
    const isLoading = records.some(({ segment }) => !segment);
    await this.#plots.show(usable, this.#query, records.length > 0, isLoading);
  }

  async #listen(id) {
    if (this.#listening.id === id) return this.#listening.stop();
    try {
      await this.#listening.play(this.#known.get(id).segment);
    } catch (error) {
      this.#list.showNotice(`Failed to play the record: ${error.message}.`);
    }
  }

  /** Redraws from known data, for another theme. */
  async redraw() {
    await this.#draw();
  }

  /** Releases the plots and stops playback. */
  dispose() {
    this.#plots.dispose();
    this.#listening.dispose();
  }
}
