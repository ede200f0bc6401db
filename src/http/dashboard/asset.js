// The overview page of an asset: fetches its data and keeps plots, selection and address in sync.

import * as api from "./api.js";
import { settle } from "./api.js";
import { refusal, unknownChannel } from "./asset-frame.js";
import { AssetHeader } from "./asset-header.js";
import { h, setChildren } from "./dom.js";
import { EventsCard } from "./events-card.js";
import { withFineItems } from "./fine-history.js";
import { hindsightOf } from "./hindsight.js";
import { assetName } from "./fleet-row.js";
import { fetchEvents } from "./life-events.js";
import { MaintenanceDialog } from "./maintenance-dialog.js";
import { namedBins, operatingBins } from "./operating-bins.js";
import { linkTimeAxes, onPointClick, onRangeChange } from "./plots.js";
import { angleAbsence } from "./record-angle.js";
import { fetchPanes } from "./record-panes.js";
import { RecordView } from "./record-view.js";
import { RecordsDialog } from "./records-dialog.js";
import { change } from "./route.js";
import { TrendsCard } from "./trends-card.js";
import { otherNames, paneNames } from "./trend-plot.js";
import { WearCard } from "./wear-card.js";
import { formatTime, timeOf, timeRange } from "./wear-plot.js";

/** Address parameters that determine what is fetched. */
const REFETCHED = ["bins", "trend", "show", "pin", "axis", "part", "gear"];

/** Parameters that redraw at once from known data and then fetch the lines they need. */
const DETAILED = ["zoom", "band", "eband", "cursor", "ecursor", "bearing", "speed", "near"];

/** The page of one asset. */
export class AssetPage {
  #id;
  #query;
  #root;
  #data = null;
  #key = "";
  #dialog;
  #header;
  #wear = new WearCard(
    () => this.#query.levels,
    () => this.redraw(),
  );
  #trends = new TrendsCard(
    () => this.#query,
    () => this.redraw(),
  );
  #record = new RecordView((parameters) => this.#keepRange(parameters));
  #dragging = false;
  #hasMesh = true;
  #maintenance;
  #events;
  #empty = h("section", { class: "card empty", hidden: true });
  #grid;

  constructor(root, route) {
    this.#root = root;
    this.#id = route.id;
    this.#query = route.query;
    this.#dialog = new RecordsDialog(route.id);
    this.#maintenance = new MaintenanceDialog(route.id);
    this.#events = new EventsCard(
      () => this.#maintenance.open(this.#shown()),
      (event) => this.#maintenance.takeBack(event, this.#shown()),
    );
    this.#header = new AssetHeader(route.id, () => this.#dialog.open());
    this.#grid = h(
      "div",
      { class: "asset-grid", hidden: true },
      h("div", { class: "column" }, this.#wear.element, this.#events.element, this.#trends.element),
      h("div", { class: "column" }, this.#record.elements),
    );
    const loading = h("p", { class: "notice loading" }, `Loading ${route.id}…`);
    setChildren(root, loading);
    document.title = `${route.id} · flankwatch`;
  }

  /** Reacts to a changed address. */
  update(route) {
    const before = this.#query;
    this.#query = route.query;
    if (!this.#data) return true;
    if (before.segment !== route.query.segment || before.channel !== route.query.channel) {
      this.#record.busy(true);
      return true;
    }
    const changed = (names) => names.some((name) => before[name] !== route.query[name]);
    if (changed(REFETCHED)) return true;
    if (!this.#dragging) this.redraw(); // the dragged range is already displayed
    return changed(DETAILED) || (changed(["time"]) && this.#isReduced());
  }

  /** What maintenance is entered for. */
  #shown() {
    const { asset, segment } = this.#data ?? {};
    const name = asset ? assetName(asset) : this.#id;
    return { name, recordTime: segment?.start_time, hasGears: this.#hasMesh };
  }

  /** Whether the plots over time do not show every record. */
  #isReduced() {
    return [this.#data.history, this.#data.trend?.response].some((shown) => shown?.reduced);
  }

  /** Writes the dragged-out range to the address. */
  #keepRange(parameters) {
    this.#dragging = true;
    change(parameters, { quiet: true });
    this.#dragging = false;
  }

  /** Without a range in the address, the whole time axis is shown. */
  #keepTime(range) {
    const time = formatTime(range);
    const { history, latest } = this.#data;
    this.#keepRange({ time: time === formatTime(timeRange(history, latest) ?? null) ? null : time });
  }

  /** Fetches the data and shows what changed. */
  async refresh(signal) {
    const asset = await settle(api.asset(this.#id, signal));
    if (asset instanceof Error) return this.#refused(asset);
    const key = JSON.stringify(this.#query);
    const isSame = asset === this.#data?.asset && key === this.#key;
    if (isSame && !(await this.#isMaintained(signal))) return;
    const { summary } = asset;
    this.#hasMesh = Boolean(asset.gear);
    this.#trends.setMesh(this.#hasMesh);
    if (!this.#data) this.#wear.element.hidden = !asset.gear?.pair; // until it is drawn
    const channel = this.#query.channel ?? summary.wear_channel ?? summary.channels[0];
    const latest = await settle(api.wear(this.#id, channel, signal));
    if (latest instanceof Error) {
      if (latest.status !== 404) return this.#refused(latest);
      unknownChannel(this.#root, asset, { ...this.#query, channel }, "asset");
      this.#data = null;
      return;
    }
    if (!this.#header.element.isConnected)
      setChildren(
        this.#root,
        this.#header.element,
        this.#empty,
        this.#grid,
        this.#dialog.element,
        this.#maintenance.element,
      );
    this.#header.update(
      asset,
      latest,
      latest.channel ?? channel,
      this.#query,
      this.#data?.channel === channel ? this.#data?.events : undefined,
    );
    if (!latest.segment_id) {
      this.#showEmpty(asset.baseline.records);
    } else {
      this.#empty.hidden = true;
      this.#grid.hidden = false; // the cards show that they are loading
      await this.#fetch(asset, latest, channel, signal);
      await this.redraw();
    }
    this.#data ??= {};
    this.#data.asset = asset;
    this.#key = key;
  }

  /** Whether maintenance was added or deleted, which changes the asset only if records follow it. */
  async #isMaintained(signal) {
    const known = this.#data.events?.maintenance;
    if (!known) return false;
    const maintenance = await settle(api.maintenance(this.#id, signal));
    return maintenance !== known && !(maintenance instanceof Error);
  }

  async #fetch(asset, latest, channel, signal) {
    const { summary } = asset;
    const id = this.#query.segment ?? latest.segment_id;
    const panes = this.#trends.chosen();
    // A record that was refused is not requested again on every update
    const known = this.#data?.id === id && this.#data.segment instanceof Error ? this.#data : null;
    const record = known
      ? Promise.resolve(known.segment)
      : settle(api.segment(id, signal)).then((segment) => {
          const foreign = !(segment instanceof Error) && segment.asset_id !== this.#id;
          return foreign
            ? new api.ApiError(404, { detail: `segment ${id} belongs to another asset` })
            : segment;
        });
    const trends = record.then(async (segment) => {
      const names = paneNames(panes, segment);
      const { bins } = this.#query;
      const own = asset.operating_bins ?? [];
      const [trend, operating] = await Promise.all([
        names.length
          ? this.#inDetail((range) => api.indicators(this.#id, channel, names, signal, range))
          : null,
        bins && bins !== "own" ? settle(api.segments(this.#id, channel, signal)) : null,
      ]);
      return {
        names,
        panes,
        response: trend,
        bins: bins === "own" ? namedBins(trend, own) : operatingBins(operating, bins),
        others: otherNames(segment),
      };
    });
    const { pin } = this.#query;
    const pinnedRecord = pin ? settle(api.segment(pin, signal)) : null;
    const panesOf = (of, known) =>
      fetchPanes(of, this.#query, signal, {
        bearings: summary.bearing_orders,
        noAngle: async () => angleAbsence(await known, asset),
      });
    const [segment, recordPanes, pinned, others, history, trend, events] = await Promise.all([
      record,
      known?.panes ?? panesOf(id, record),
      pinnedRecord,
      pinnedRecord && panesOf(pin, pinnedRecord),
      this.#inDetail((range) => api.wearHistory(this.#id, channel, signal, range)),
      trends,
      this.#fetchEvents(asset, channel, signal),
    ]);
    this.#data = {
      asset,
      latest,
      channel,
      id,
      segment,
      panes: recordPanes,
      pinned,
      others,
      history,
      trend,
      events,
    };
  }

  /** What `ask` answers for all times, with every record of the zoomed range. */
  async #inDetail(ask) {
    return withFineItems(await settle(ask()), timeOf(this.#query.time), (range) => settle(ask(range)));
  }

  async #fetchEvents(asset, channel, signal) {
    const events = await fetchEvents(this.#id, channel, signal);
    return { ...events, hindsight: await hindsightOf(asset, channel, events.maintenance, signal) };
  }

  /** Redraws from known data, for a changed address or theme. */
  async redraw() {
    if (!this.#data?.history) return;
    const { asset, latest, channel, id, segment, history, events } = this.#data;
    this.#events.show(events);
    const revision = `${this.#id} ${channel}`;
    const selected = segment.start_time ?? null;
    const points = history instanceof Error ? [] : history.items;
    this.#header.update(asset, latest, channel, this.#query, events);
    this.#header.recall(points, latest);
    this.#record.place(
      points.map((item) => item.segment_id),
      id,
      !this.#query.segment,
    );
    await Promise.all([
      this.#wear.update(this.#data, this.#query, selected, revision),
      this.#trends.update(this.#data, selected, revision),
      this.#record.show(this.#data, asset, this.#query),
    ]);
    const select = (clicked) => change({ segment: clicked });
    onPointClick(this.#wear.plot, select);
    onPointClick(this.#trends.plot, select);
    linkTimeAxes(this.#wear.plot, this.#trends.plot);
    for (const { plot } of [this.#wear, this.#trends]) onRangeChange(plot, (range) => this.#keepTime(range));
  }

  #showEmpty(need) {
    this.#grid.hidden = true;
    this.#empty.hidden = false;
    const example = `curl -X POST '${api.address(["assets", this.#id, "segments"])}' \\\n  -H 'content-type: audio/wav' --data-binary @record.wav`;
    setChildren(
      this.#empty,
      h("h2", {}, "Waiting for the first record"),
      h(
        "p",
        {},
        `Add vibration records taken while the machine is healthy, in the order they were taken. The first ${need} form the baseline for all later records.`,
      ),
      h(
        "p",
        {},
        h("button", { type: "button", class: "primary", onclick: () => this.#dialog.open() }, "Add records…"),
        " or drop WAV, FLAC, CSV, MATLAB, NumPy or MCAP files anywhere on this page.",
      ),
      h(
        "details",
        {},
        h("summary", {}, "Or with the API"),
        h("pre", { tabindex: "0" }, h("code", {}, example)),
      ),
    );
  }

  #refused(error) {
    refusal(this.#root, this.#id, error);
    this.#data = null;
  }

  /** Sends files dropped on the page. */
  takeFiles(files) {
    return this.#dialog.take(files);
  }

  /** Updates the displayed ages. */
  tick() {
    if (this.#header.element.isConnected) this.#header.tick();
    this.#dialog.tick();
  }

  /** Frees the plots. */
  dispose() {
    this.#wear.dispose();
    this.#trends.dispose();
    this.#record.dispose();
    this.#dialog.dispose();
    this.#maintenance.dispose();
  }
}
