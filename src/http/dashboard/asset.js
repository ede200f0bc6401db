// The overview page of an asset: fetches its data and keeps plots, selection and address in sync.

import * as api from "./api.js";
import { LevelHandles } from "./alarm-levels.js";
import { AlarmRulePanel, watches } from "./alarm-rule-panel.js";
import { answer } from "./api.js";
import { refusal } from "./asset-frame.js";
import { AssetHeader } from "./asset-header.js";
import { h, setChildren, setOptions } from "./dom.js";
import { EventsCard } from "./events-card.js";
import { withFineItems } from "./fine-history.js";
import { hindsightOf } from "./hindsight.js";
import { fetchEvents } from "./life-events.js";
import { MaintenanceDialog } from "./maintenance-dialog.js";
import { lifeOrigin, lifeSpan, lifeSubject } from "./plot-subjects.js";
import { PlotCard } from "./plot-card.js";
import { indicatorName } from "./format.js";
import { namedBins, operatingBins } from "./operating-bins.js";
import { linkTimeAxes, onPointClick, onRangeChange } from "./plots.js";
import { angleAbsence } from "./record-angle.js";
import { fetchPanes } from "./record-panes.js";
import { RecordView } from "./record-view.js";
import { RecordsDialog } from "./records-dialog.js";
import { change } from "./route.js";
import { chosenPanes, otherNames, PANES, paneNames, trendDrawing } from "./trend-plot.js";
import { formatTime, timeOf, timeRange, wearDrawing, withoutEstimate } from "./wear-plot.js";

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
  #wear = new PlotCard("wear", "Wear over time");
  #trends = new PlotCard("trends", "Indicator trends");
  #record = new RecordView((parameters) => this.#keepRange(parameters));
  #dragging = false;
  #hasMesh = true;
  #maintenance;
  #events;
  #panes = new Map();
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
  #levels = new AlarmRulePanel(
    () => this.redraw(),
    (name) => change({ levels: name }, { quiet: true }),
  );
  #handles = new LevelHandles(this.#trends.plot, (key, value) => this.#levels.setLevel(key, value));
  #levelsButton = this.#levelsToggle(() => this.#levelNames());
  #wearLevels = new AlarmRulePanel(
    () => this.redraw(),
    () => {},
    "wear-rule",
  );
  #wearHandles = new LevelHandles(this.#wear.plot, (key, value) => this.#wearLevels.setLevel(key, value));
  #wearLevelsButton = this.#levelsToggle(() => ["wear_um"]);
  #empty = h("section", { class: "card empty", hidden: true });
  #grid;

  constructor(root, route) {
    this.#root = root;
    this.#id = route.id;
    this.#query = route.query;
    this.#dialog = new RecordsDialog(route.id);
    this.#maintenance = new MaintenanceDialog(route.id);
    this.#events = new EventsCard(
      () => this.#maintenance.open(this.#data?.segment?.start_time, this.#hasMesh),
      (event) => this.#maintenance.takeBack(event),
    );
    this.#header = new AssetHeader(route.id, () => this.#dialog.open());
    const chips = h("div", { class: "chips", role: "group", "aria-label": "Indicators" });
    for (const { key, label } of PANES) {
      const chip = h(
        "button",
        { type: "button", class: "chip", "data-key": key, onclick: () => this.#togglePane(key) },
        label,
      );
      this.#panes.set(key, chip);
      chips.append(chip);
    }
    this.#trends.tools.append(
      chips,
      this.#more,
      this.#bins,
      h("label", { class: "check", for: "trend-log" }, this.#log, "Log"),
      this.#levelsButton,
    );
    this.#trends.frame.append(this.#handles.element);
    this.#trends.element.append(this.#levels.element);
    this.#wear.tools.append(this.#wearLevelsButton);
    this.#wear.frame.append(this.#wearHandles.element);
    this.#wear.element.append(this.#wearLevels.element);
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

  /** A button that shows the alarm levels of the first indicator in `names`, or hides those shown. */
  #levelsToggle(names) {
    const toggle = () =>
      change({ levels: names().includes(this.#query.levels) ? null : names()[0] }, { quiet: true });
    return h("button", { type: "button", "aria-expanded": "false", onclick: toggle }, "Alarm levels…");
  }

  #togglePane(key) {
    const keys = this.#chosen().map((pane) => pane.key);
    const next = keys.includes(key) ? keys.filter((other) => other !== key) : [...keys, key];
    if (next.length) change({ trend: next.join(",") }, { quiet: true });
  }

  #chosen() {
    return chosenPanes(this.#query.trend, this.#hasMesh);
  }

  /** The displayed indicators for which alarm levels can be set. */
  #levelNames() {
    return this.#chosen()
      .filter((pane) => pane.names.length === 1)
      .map((pane) => pane.names[0]);
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

  /** Whether the plots over time do not show every record. */
  #isReduced() {
    return [this.#data.history, this.#data.trend?.answer].some((shown) => shown?.reduced);
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
    const asset = await answer(api.asset(this.#id, signal));
    if (asset instanceof Error) return this.#refused(asset);
    const key = JSON.stringify(this.#query);
    if (asset === this.#data?.asset && key === this.#key) return;
    const { summary } = asset;
    this.#hasMesh = Boolean(asset.gear);
    for (const { key, ofMesh } of PANES) this.#panes.get(key).hidden = Boolean(ofMesh) && !this.#hasMesh;
    const channel = this.#query.channel ?? summary.wear_channel ?? summary.channels[0];
    const latest = await answer(api.wear(this.#id, channel, signal));
    if (latest instanceof Error) return this.#refused(latest);
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

  async #fetch(asset, latest, channel, signal) {
    const id = this.#query.segment ?? latest.segment_id;
    const panes = this.#chosen();
    // a record that was refused is not requested again on every update
    const known = this.#data?.id === id && this.#data.segment instanceof Error ? this.#data : null;
    const record = known
      ? Promise.resolve(known.segment)
      : answer(api.segment(id, signal)).then((segment) => {
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
        bins && bins !== "own" ? answer(api.segments(this.#id, channel, signal)) : null,
      ]);
      return {
        names,
        panes,
        answer: trend,
        bins: bins === "own" ? namedBins(trend, own) : operatingBins(operating, bins),
        others: otherNames(segment),
      };
    });
    const { pin } = this.#query;
    const pinnedRecord = pin ? answer(api.segment(pin, signal)) : null;
    const panesOf = (of, known) =>
      fetchPanes(of, this.#query, signal, { noAngle: async () => angleAbsence(await known, asset) });
    const [segment, recordPanes, pinned, others, history, trend, events] = await Promise.all([
      record,
      known?.panes ?? panesOf(id, record),
      pinnedRecord,
      pinnedRecord && panesOf(pin, pinnedRecord),
      this.#inDetail((range) => api.wearHistory(this.#id, channel, signal, range)),
      trends,
      this.#fetchEvents(channel, signal),
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
    return withFineItems(await answer(ask()), timeOf(this.#query.time), (range) => answer(ask(range)));
  }

  async #fetchEvents(channel, signal) {
    const events = await fetchEvents(this.#id, channel, signal);
    return { ...events, hindsight: await hindsightOf(this.#id, channel, events.maintenance, signal) };
  }

  /** Redraws from known data, for a changed address or theme. */
  async redraw() {
    if (!this.#data?.history) return;
    const { asset, latest, channel, id, segment, history, trend, events } = this.#data;
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
      this.#drawWear(history, latest, selected, revision, events),
      this.#drawTrends(trend, selected, revision, events, history, latest),
      this.#record.show(this.#data, asset, this.#query),
    ]);
    const select = (clicked) => change({ segment: clicked });
    onPointClick(this.#wear.plot, select);
    onPointClick(this.#trends.plot, select);
    linkTimeAxes(this.#wear.plot, this.#trends.plot);
    for (const { plot } of [this.#wear, this.#trends]) onRangeChange(plot, (range) => this.#keepTime(range));
  }

  #drawWear(history, latest, selected, revision, events) {
    const { asset } = this.#data;
    const missing =
      history instanceof Error
        ? history.message
        : history.items.length === 0
          ? "This channel has no records yet."
          : withoutEstimate(history.items);
    // without a pair there is no wear, as the header says
    const isBare =
      !asset.gear?.pair &&
      !(history instanceof Error) &&
      history.items.every((item) => item.median_um == null);
    this.#wear.element.hidden = isBare;
    if (isBare) return;
    this.#wearLevelsButton.hidden = Boolean(missing);
    const rules = this.#wearLevels.show({
      asset,
      channel: history.channel,
      names: missing ? [] : ["wear_um"],
      units: { wear_um: "µm" },
      name: this.#query.levels,
    });
    const isShown = !this.#wearLevels.element.hidden;
    this.#wearLevelsButton.setAttribute("aria-expanded", String(isShown));
    if (missing) {
      this.#wearHandles.show(null, []);
      return this.#wear.showNotice(missing);
    }
    const rule = rules.find((each) => watches(each, "wear_um"));
    const zoomed = timeOf(this.#query.time);
    return this.#wear
      .show(
        () => wearDrawing(history, latest.limits, selected, revision, latest, events, zoomed, rule),
        `${this.#id}-wear-${lifeSpan(history.items)}`,
        () => lifeSubject(asset, history.channel, history.items),
        () => lifeOrigin(asset, history.channel, history.items),
      )
      .then(() => this.#wearHandles.show(isShown ? 0 : null, this.#wearLevels.levels()));
  }

  #drawTrends(
    { names, panes, answer: indicators, bins, others },
    selected,
    revision,
    events,
    history,
    latest,
  ) {
    this.#bins.value = this.#query.bins ?? "";
    this.#bins.querySelector("[value=own]").hidden = !this.#data.asset.operating_bins?.length;
    this.#offer(others, panes);
    const logarithmic = this.#query.log === "1";
    this.#log.checked = logarithmic;
    for (const [key, chip] of this.#panes)
      chip.setAttribute("aria-pressed", String(panes.some((pane) => pane.key === key)));
    if (!indicators) return this.#trends.showNotice("This record does not have these indicators.");
    if (indicators instanceof Error) return this.#trends.showNotice(indicators.message);
    const range = timeOf(this.#query.time) ?? timeRange(history, latest);
    this.#trends.plot.style.setProperty("--panes", panes.length);
    const rules = this.#levels.show({
      asset: this.#data.asset,
      channel: indicators.channel,
      names: this.#levelNames(),
      units: indicators.units,
      name: this.#query.levels,
    });
    this.#levelsButton.hidden = this.#levelNames().length === 0;
    this.#levelsButton.setAttribute("aria-expanded", String(!this.#levels.element.hidden));
    const { asset } = this.#data;
    const { velocity_limits_mm_per_s: limits } = asset.summary;
    const drawing = () =>
      trendDrawing(indicators, panes, names, logarithmic, selected, {
        revision,
        bins,
        events,
        range,
        rules,
        limits,
      });
    const pane = panes.findIndex((each) => each.names.length === 1 && each.names[0] === this.#query.levels);
    return this.#trends
      .show(
        drawing,
        `${this.#id}-trends-${lifeSpan(indicators.items)}`,
        () => lifeSubject(asset, indicators.channel, indicators.items),
        () => lifeOrigin(asset, indicators.channel, indicators.items),
      )
      .then(() => this.#handles.show(pane < 0 ? null : pane, this.#levels.levels()));
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
    this.#levels.dispose();
    this.#wearLevels.dispose();
    this.#record.dispose();
    this.#dialog.dispose();
    this.#maintenance.dispose();
  }
}
