// One record: when it was taken, its indicators, its spectra and its posterior. Follows the selection of the page.

import { h, setChildren, setText } from "./dom.js";
import { absence, count, hertz, indicatorName, number, span, unit, utc } from "./format.js";
import { PlotCard } from "./plot-card.js";
import { posteriorDrawing } from "./posterior-plot.js";
import { change } from "./route.js";
import { envelopeDrawing, spectrumDrawing } from "./spectrum-plot.js";

const SHOWN = ["rms", "peak", "crest_factor", "kurtosis", "omx"];
const UNITLESS = ["kurtosis", "crest_factor"];

function check(id, label, onchange) {
  const input = h("input", { type: "checkbox", id, onchange: () => onchange(input.checked) });
  return { input, element: h("label", { class: "check", for: id }, input, label) };
}

/** The record's part of an asset's page. */
export class RecordView {
  #time = h("h2");
  #words = h("p", { class: "muted" });
  #values = h("dl", { class: "facts values" });
  #previous = h("button", { type: "button", onclick: () => this.#step(-1) }, "◀ Previous");
  #next = h("button", { type: "button", onclick: () => this.#step(1) }, "Next ▶");
  #latest = h("button", { type: "button", "aria-pressed": "true", onclick: () => change({ segment: null }) }, "Latest");
  #log = check("spectrum-log", "Log", (on) => change({ slog: on ? "1" : null }, { quiet: true }));
  #sidebands = check("sidebands", "Sidebands", (on) => this.#showSidebands(on));
  #zoom = h("select", { id: "spectrum-zoom", "aria-label": "Part of the spectrum", onchange: () => change({ zoom: this.#zoom.value }, { quiet: true }) });
  #order = { ids: [], selected: null };
  #spectrum = new PlotCard("spectrum", "Spectrum");
  #envelope = new PlotCard("envelope", "Envelope spectrum");
  #posterior = new PlotCard("posterior", "Posterior over wear depth");
  elements;

  constructor() {
    setText(this.#time, "Loading the record…");
    for (const control of [this.#previous, this.#next, this.#zoom, this.#sidebands.input]) control.disabled = true;
    this.#zoom.append(h("option", { value: "" }, "Whole spectrum"));
    this.#spectrum.tools.append(this.#zoom, this.#sidebands.element, this.#log.element);
    const buttons = h("div", { class: "steps", role: "group", "aria-label": "Choose a record" }, this.#previous, this.#next, this.#latest);
    const bar = h("section", { class: "card record-bar", "aria-label": "Selected record" }, h("div", { class: "plot-head" }, this.#time, buttons), this.#words, this.#values);
    this.elements = [bar, this.#spectrum.element, this.#envelope.element, this.#posterior.element];
  }

  /** Sidebands are too close to be told apart in the whole spectrum, so they bring the first mesh line near. */
  #showSidebands(on) {
    change({ side: on ? "1" : null, zoom: on ? this.#zoom.value || "1" : this.#zoom.value }, { quiet: true });
  }

  #step(by) {
    const { ids, selected } = this.#order;
    const next = ids[ids.indexOf(selected) + by];
    if (next) change({ segment: next });
  }

  /** Tells which records there are, in order of time, and which one is shown. */
  place(ids, selected, following) {
    this.#order = { ids, selected };
    const index = ids.indexOf(selected);
    this.#previous.disabled = index <= 0;
    this.#next.disabled = index < 0 || index === ids.length - 1;
    this.#latest.setAttribute("aria-pressed", String(following));
    this.#latest.textContent = following ? "Following latest" : "Latest";
  }

  /** Marks the plots as being fetched. */
  busy(is) {
    for (const card of [this.#spectrum, this.#envelope, this.#posterior]) card.busy(is);
  }

  /** Shows a record: `segment`, `spectrum` and `envelope` are answers of the server or errors. */
  async show({ segment, spectrum, envelope }, asset, query) {
    const view = { logarithmic: query.slog === "1", sidebands: query.side === "1", zoom: query.zoom ?? "" };
    this.#log.input.checked = view.logarithmic;
    this.#sidebands.input.checked = view.sidebands;
    this.#showFacts(segment);
    this.#showZooms(spectrum, view.zoom);
    const revision = `${asset.id} ${segment.channel ?? ""}`;
    await Promise.all([
      this.#plot(this.#spectrum, spectrum, () => spectrumDrawing(spectrum, view, revision), "spectrum", segment),
      this.#plot(this.#envelope, envelope, () => envelopeDrawing(envelope, asset.gear.teeth, view, revision), "envelope", segment),
      this.#showPosterior(segment, asset, revision),
    ]);
    this.busy(false);
  }

  async #plot(card, data, drawing, kind, segment) {
    if (data instanceof Error) return card.say(data.message);
    if (data.frequency_hz.length === 0) return card.say("The record is too short for a spectrum.");
    return card.show(drawing(), `${segment.asset_id}-${kind}-${segment.start_time}`);
  }

  async #showPosterior(segment, asset, revision) {
    if (segment instanceof Error) return this.#posterior.say("There is no record to show.");
    const { wear, reference_wear_um: reference } = segment;
    if (!wear?.posterior) return this.#posterior.say(wear?.reason ? `No posterior: ${wear.reason}.` : "No posterior for this record.");
    return this.#posterior.show(posteriorDrawing(wear, asset.limits, reference, revision), `${asset.id}-posterior-${segment.start_time}`);
  }

  #showZooms(spectrum, zoom) {
    const orders = spectrum instanceof Error ? [] : spectrum.mesh_harmonics.map(({ order }) => order);
    const choices = [["", "Whole spectrum"], ...orders.map((order) => [String(order), `Around ${order}× mesh`])];
    if (this.#zoom.dataset.choices !== String(orders)) {
      this.#zoom.dataset.choices = String(orders);
      setChildren(this.#zoom, choices.map(([value, label]) => h("option", { value }, label)));
    }
    this.#zoom.value = orders.includes(Number(zoom)) ? zoom : "";
    this.#zoom.disabled = orders.length === 0;
    this.#sidebands.input.disabled = orders.length === 0;
  }

  #showFacts(segment) {
    if (segment instanceof Error) {
      setText(this.#time, "Record not found");
      setText(this.#words, `${segment.message}. “Latest” shows the newest record.`);
      setChildren(this.#values);
      return;
    }
    setText(this.#time, utc(segment.start_time));
    const length = segment.samples / segment.sample_rate_hz;
    const torque = segment.operating_point?.torque_nm;
    const load = torque == null ? "" : `, ${number(torque)} N·m`;
    const speed = segment.shaft_speed ? `, shaft ${hertz(segment.shaft_speed.shaft_speed_hz)}` : "";
    setText(this.#words, `Channel ${segment.channel}, ${length < 10 ? number(length, 3) + " s" : span(length)} at ${hertz(segment.sample_rate_hz)}, ${count(segment.samples)} samples${speed}${load}`);
    const { indicators: values = {}, absent = {} } = segment;
    const names = SHOWN.filter((name) => name in values || name in absent);
    setChildren(this.#values, names.map((name) => value(name, values[name], absent[name], segment.unit)));
  }

  /** Frees the plots. */
  dispose() {
    for (const card of [this.#spectrum, this.#envelope, this.#posterior]) card.dispose();
  }
}

function value(name, amount, reason, unitName) {
  const shown = amount == null ? h("span", { class: "muted" }, absence(reason ?? "absent")) : `${number(amount)} ${UNITLESS.includes(name) ? "" : unit(unitName)}`.trim();
  return h("div", { class: "fact" }, h("dt", {}, indicatorName(name)), h("dd", {}, shown));
}
