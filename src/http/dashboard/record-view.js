// One record: its time, indicators and views. Follows the page's selection.

import { BearingPanel, firstBearing } from "./bearing-panel.js";
import { compareOnBench } from "./bench-records.js";
import { compared } from "./comparison.js";
import { CursorLayer } from "./cursor.js";
import { cursorOf, formatCursor } from "./cursor-lines.js";
import { withCursor } from "./cursor-picture.js";
import { h, setChildren, setText } from "./dom.js";
import { clock } from "./format.js";
import { selectedAndPinned } from "./layers.js";
import { LineTable } from "./line-table.js";
import { recordOrigin, recordSubject } from "./plot-subjects.js";
import { LOADING, PlotCard } from "./plot-card.js";
import { onRangeChange } from "./plots.js";
import { pinnedWords, recordFacts, recordWords } from "./record-facts.js";
import { GearChoice } from "./gear-choice.js";
import { formatPart, PANES, partOf, shownPanes } from "./record-panes.js";
import { change, parse } from "./route.js";
import { isNear } from "./spectrum-plot.js";
import { SpectrumAids } from "./spectrum-aids.js";
import { SpectrumTools } from "./spectrum-tools.js";

const isUsable = (spectrum) =>
  Boolean(spectrum) && !(spectrum instanceof Error) && spectrum.frequency_hz.length > 0;
const endOf = (spectrum) => spectrum.frequency_hz.at(-1);

/** The cursor of an address over a spectrum, which may be missing or an error; null for none. */
const cursorIn = (spectrum, query, parameter = "cursor") =>
  isUsable(spectrum) ? cursorOf(query, spectrum, parameter) : null;

/** The record section of an asset's page. */
export class RecordView {
  #time = h("h2");
  #words = h("p", { class: "muted record-words" });
  #pinnedWords = h("p", { class: "pinned-value", hidden: true });
  #values = h("dl", { class: "facts values" });
  #previous = h("button", { type: "button", onclick: () => this.#step(-1) }, "◀ Previous");
  #next = h("button", { type: "button", onclick: () => this.#step(1) }, "Next ▶");
  #latest = h(
    "button",
    { type: "button", "aria-pressed": "true", onclick: () => change({ segment: null }) },
    "Latest",
  );
  #pin = h(
    "button",
    { type: "button", "aria-pressed": "false", onclick: () => this.#togglePin() },
    "Pin to compare",
  );
  #compare = h("button", { type: "button", onclick: () => this.#toBench() }, "Compare…");
  #chips = new Map();
  #order = { ids: [], selected: null };
  #query = {};
  #cards = new Map(PANES.map(({ key, label }) => [key, new PlotCard(key, label, { rests: true })]));
  #tools = new SpectrumTools();
  #near = h(
    "select",
    {
      id: "envelope-range",
      "aria-label": "Part of the envelope spectrum",
      onchange: () => change({ near: this.#near.value, eband: null }, { quiet: true }),
    },
    [
      ["0", "Whole band"],
      ["1", "Shaft and bearing lines"],
    ].map(([value, text]) => h("option", { value }, text)),
  );
  #gear = new GearChoice();
  #cursor;
  #bearing = new BearingPanel();
  #envelopeAids;
  #lines = new LineTable();
  #onRange;
  elements;

  /** `onRange(parameters)` receives the address parameters of a dragged-out range. */
  constructor(onRange) {
    this.#onRange = onRange;
    setText(this.#time, "Loading record…");
    for (const control of [this.#previous, this.#next]) control.disabled = true;
    const spectrum = this.#cards.get("spectrum");
    spectrum.tools.append(...this.#tools.elements);
    this.#cursor = new CursorLayer(spectrum, (cursor) =>
      change({ cursor: formatCursor(cursor) }, { quiet: true }),
    );
    spectrum.frame.before(this.#cursor.readout);
    spectrum.element.append(this.#lines.element);
    const envelope = this.#cards.get("envelope");
    envelope.tools.append(this.#near);
    this.#envelopeAids = new SpectrumAids(envelope, { cursor: "ecursor", part: "eband" });
    this.#cards.get("turn").tools.append(this.#gear.element);
    this.#bearing.element.hidden = true; // until a cursor needs it
    const chips = h("div", { class: "chips", role: "group", "aria-label": "Views" });
    for (const { key, label } of PANES) {
      const chip = h("button", { type: "button", class: "chip", onclick: () => this.#toggle(key) }, label);
      this.#chips.set(key, chip);
      chips.append(chip);
    }
    const buttons = h(
      "div",
      { class: "steps", role: "group", "aria-label": "Select a record" },
      this.#previous,
      this.#next,
      this.#latest,
      this.#pin,
      this.#compare,
    );
    const head = h("div", { class: "plot-head" }, this.#time, buttons);
    const bar = h(
      "section",
      { class: "card record-bar", "aria-label": "Selected record" },
      head,
      this.#words,
      this.#pinnedWords,
      this.#values,
      chips,
      this.#bearing.element,
    );
    const shown = shownPanes(parse(location.hash).query);
    // Until the asset is known to have a gear pair, there is no posterior
    for (const [key, card] of this.#cards) card.element.hidden = !shown.includes(key) || key === "posterior";
    this.elements = [bar, ...[...this.#cards.values()].map(({ element }) => element)];
  }

  #toggle(key) {
    // Uses the address, not the drawing: another click may precede the response to the first
    const keys = shownPanes(parse(location.hash).query);
    const next = keys.includes(key) ? keys.filter((other) => other !== key) : [...keys, key];
    change({ show: next.join(",") || "none" }, { quiet: true });
  }

  #togglePin() {
    change({ pin: this.#query.pin ? null : this.#order.selected }, { quiet: true });
  }

  /** The bench compares records of any assets. */
  #toBench() {
    const ids = [this.#query.pin, this.#order.selected].filter(Boolean);
    if (ids.length) compareOnBench(ids);
  }

  #step(by) {
    const { ids, selected } = this.#order;
    const next = ids[ids.indexOf(selected) + by];
    if (next) change({ segment: next });
  }

  /** Sets the records in order of time, and which one is displayed. */
  place(ids, selected, following) {
    this.#order = { ids, selected };
    const index = ids.indexOf(selected);
    this.#previous.disabled = index <= 0;
    this.#next.disabled = index < 0 || index === ids.length - 1;
    this.#latest.setAttribute("aria-pressed", String(following));
    this.#latest.textContent = following ? "Following latest" : "Latest";
  }

  /** Marks the plots as loading. */
  busy(is) {
    for (const card of this.#cards.values()) card.busy(is);
  }

  /** Shows a record: `segment`, `pinned` and the values of `panes` and `others` are answers or errors. */
  async show({ segment, pinned, panes, others }, asset, query) {
    this.#query = query;
    const hasPair = Boolean(asset.gear?.pair);
    const keys = shownPanes(query).filter((key) => key !== "posterior" || hasPair);
    this.#chips.get("posterior").hidden = !hasPair;
    const near = isNear(query, asset.summary.bearing_orders ?? {});
    this.#near.value = near ? "1" : "0";
    this.#gear.show(query, asset.gear?.teeth, Boolean(asset.gear));
    const view = {
      ...this.#tools.update(panes.spectrum, query, firstBearing(asset), Boolean(asset.gear)),
      near,
      part: partOf(query.band),
      envelopePart: partOf(query.eband),
    };
    for (const [key, chip] of this.#chips) chip.setAttribute("aria-pressed", String(keys.includes(key)));
    for (const [key, card] of this.#cards) card.element.hidden = !keys.includes(key);
    this.#showFacts(segment, pinned);
    const duration = segment.samples / segment.sample_rate_hz;
    const context = {
      segment,
      pinned,
      asset,
      query,
      view,
      duration,
      revision: `${asset.id} ${segment.channel ?? ""}`,
    };
    await Promise.all(
      PANES.filter(({ key }) => keys.includes(key)).map((pane) =>
        this.#draw(pane, panes[pane.key], others?.[pane.key], context),
      ),
    );
    const { spectrum } = panes;
    const cursor = cursorIn(spectrum, query);
    this.#cursor.show(cursor, spectrum);
    this.#lines.show(segment instanceof Error ? null : spectrum, cursor, view);
    this.#showBearing(panes, segment, asset, query);
    for (const [key, parameter] of [
      ["waveform", "part"],
      ["spectrum", "band"],
      ["envelope", "eband"],
    ]) {
      onRangeChange(this.#cards.get(key).plot, (range) => this.#onRange({ [parameter]: formatPart(range) }));
    }
    this.busy(false);
  }

  /** The bearing that a cursor marks, and the cursor of the envelope. */
  #showBearing({ spectrum, envelope }, segment, asset, query) {
    const usable = isUsable(envelope) && !(segment instanceof Error);
    const layers = usable ? [{ data: envelope, colour: "", name: "", pointed: "", prefix: "" }] : [];
    this.#envelopeAids.show(query, layers, firstBearing(asset));
    this.#bearing.element.hidden = query.cursor !== "b" && query.ecursor !== "b";
    const inOrders = spectrum?.axis && query.ecursor !== "b";
    this.#bearing.show(query, [asset], inOrders ? null : segment.shaft_speed?.shaft_speed_hz);
  }

  /** @param {(typeof PANES)[number]} pane */
  async #draw({ key, fetch, draw }, data, other, context) {
    const card = this.#cards.get(key);
    if (context.segment instanceof Error) return card.showNotice("No record to display.");
    if (data instanceof Error) return card.showNotice(data.message);
    if (fetch && !data) return card.showNotice(LOADING);
    const { segment, pinned } = context;
    const make = () => {
      const drawing = draw(selectedAndPinned(data, other), context);
      return drawing.others?.length && pinned.start_time ? compared(drawing, segment, pinned) : drawing;
    };
    const parameter = { spectrum: "cursor", envelope: "ecursor" }[key];
    const cursor = parameter ? cursorIn(data, this.#query, parameter) : null;
    const shown = (isPicture) => (isPicture && cursor ? withCursor(make(), cursor, endOf(data)) : make());
    return card.show(
      shown,
      `${context.asset.id}-${key}-${segment.start_time}`,
      () => recordSubject(segment, context.asset),
      () => recordOrigin(segment, context.asset, other && pinned),
    );
  }

  #showFacts(segment, pinned) {
    this.#pin.setAttribute("aria-pressed", String(Boolean(this.#query.pin)));
    this.#pin.textContent = this.#query.pin ? "Unpin" : "Pin to compare";
    this.#pinnedWords.hidden = !pinned;
    if (pinned) setText(this.#pinnedWords, pinnedWords(pinned));
    if (segment instanceof Error) {
      setText(this.#time, "Record not found");
      setText(this.#words, `${segment.message}. “Latest” shows the newest record.`);
      setChildren(this.#values);
      return;
    }
    setText(this.#time, clock(segment.start_time));
    setText(this.#words, recordWords(segment));
    setChildren(this.#values, recordFacts(segment, pinned instanceof Error ? null : pinned));
  }

  /** Releases the plots. */
  dispose() {
    for (const card of this.#cards.values()) card.dispose();
  }
}
