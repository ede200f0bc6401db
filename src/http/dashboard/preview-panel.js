// Wear preview of a gear pair: sliders for wear, torque and speed, the teeth, and the model's predictions.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { FlankCard } from "./flank-drawing.js";
import { decibels, depth, hertz, number } from "./format.js";
import { PlotCard } from "./plot-card.js";
import { palette } from "./plots.js";
import { PairDrawing } from "./preview-drawing.js";
import {
  Extents,
  harmonicsPlot,
  spectrumPlot,
  stiffnessPlot,
  transmissionPlot,
  waveformPlot,
} from "./preview-plots.js";
import { PreviewRequests } from "./preview-request.js";

const WEAR_STEPS = 245;
const ROLL_S = 2.4; // seconds per mesh period while the teeth roll
const BEGINNING = 0.4; // initial depth, as a fraction of the maximum
const AHEAD = 8; // depths up to the maximum for which the axis ranges are computed
const AHEAD_MS = 150;

/** A slider with label and value; `words(value)` formats the value. */
function slider(name, label, words, onInput) {
  const output = h("output", { for: `preview-${name}` });
  const input = h("input", {
    type: "range",
    id: `preview-${name}`,
    min: "0",
    max: "1",
    step: "any",
    oninput: () => (show(), onInput()),
  });
  function show() {
    setText(output, words(Number(input.value)));
    input.setAttribute("aria-valuetext", output.textContent);
  }
  const element = h(
    "div",
    { class: `preview-slider preview-slider-${name}` },
    h("label", { for: `preview-${name}` }, label),
    output,
    input,
  );
  return { element, input, show };
}

/** The panel; `onPreview(preview, request)` receives every response, `onError(error)` every refusal. */
export class PreviewPanel {
  #gear;
  #owner = "";
  #preview;
  #requests;
  #onPreview;
  #onError;
  #extents = new Extents();
  #ahead;
  #limits;
  #wear = slider(
    "wear",
    "Wear depth",
    (value) => `${depth(value)} µm`,
    () => this.#ask(),
  );
  #torque = slider(
    "torque",
    "Torque",
    (value) => `${number(value, 3)} N·m`,
    () => this.#ask(),
  );
  #speed = slider(
    "speed",
    "Shaft speed",
    (value) => `${hertz(Number(value.toPrecision(4)))}, ${number(value * 60, 4)} rpm`,
    () => this.#ask(),
  );
  #roll = h(
    "button",
    { type: "button", "aria-pressed": "false", onclick: () => this.#toggleRoll() },
    "▶ Roll teeth",
  );
  #facts = h("dl", { class: "preview-facts", "aria-live": "polite" });
  #words = h("p", { class: "notice", hidden: true });
  #drawing = new PairDrawing();
  #flanks = new FlankCard("Worn flanks");
  #cards = {
    harmonics: new PlotCard("harmonics", "Mesh harmonics, change from unworn"),
    stiffness: new PlotCard("stiffness", "Mesh stiffness"),
    transmission: new PlotCard("transmission", "Transmission error"),
    waveform: new PlotCard("preview-waveform", "Expected vibration"),
    spectrum: new PlotCard("preview-spectrum", "Expected spectrum"),
  };
  #results;
  #rolling = 0;
  #part = 0.5;
  element;

  constructor({ onPreview = () => {}, onError = () => {} } = {}) {
    [this.#onPreview, this.#onError] = [onPreview, onError];
    this.#requests = new PreviewRequests(
      (preview, request) => this.#answered(preview, request),
      (error) => this.#failed(error),
    );
    const mesh = h(
      "figure",
      { class: "card preview-mesh", "data-plot": "mesh" },
      h("div", { class: "plot-head" }, h("h2", {}, "Teeth in mesh"), this.#roll),
      this.#drawing.element,
    );
    const { harmonics, stiffness, transmission, waveform, spectrum } = this.#cards;
    this.#results = h(
      "div",
      { class: "preview-results", hidden: true },
      mesh,
      this.#flanks.element,
      harmonics.element,
      spectrum.element,
      waveform.element,
      stiffness.element,
      transmission.element,
    );
    const controls = h(
      "div",
      { class: "card preview-controls" },
      h("div", { class: "preview-sliders" }, this.#wear.element, this.#torque.element, this.#speed.element),
      this.#facts,
    );
    this.element = h(
      "section",
      { class: "preview", "aria-label": "Wear preview" },
      controls,
      this.#words,
      this.#results,
    );
    this.#showNotice("Enter the data of a gear pair.");
  }

  /** Previews the mesh of an asset named `owner`, after `wait` milliseconds without another call. */
  describe(gear, wait = 0, owner = "") {
    this.#gear = gear;
    this.#owner = owner;
    this.#ask(wait);
  }

  /** Shows why there is nothing to preview. */
  #showNotice(words) {
    this.#words.hidden = !words;
    setText(this.#words, words ?? "");
    this.#results.hidden = Boolean(words);
    this.#wear.element.parentElement.inert = Boolean(words);
    if (words) {
      setChildren(this.#facts);
      this.#stopRolling();
    }
  }

  /** Shows that the data are incomplete. */
  lacking(words) {
    this.#gear = undefined;
    this.#showNotice(words);
  }

  #ask(wait = 0) {
    if (!this.#gear) return;
    const request = { gear: this.#gear };
    if (this.#limits)
      Object.assign(request, {
        wear_um: this.#value(this.#wear),
        torque_nm: this.#value(this.#torque),
        shaft_speed_hz: this.#value(this.#speed),
      });
    // Another pair has other limits
    if (this.#limits && this.#limits.key !== pairKey(this.#gear)) {
      request.wear_um =
        (Number(this.#wear.input.value) / Number(this.#wear.input.max)) * this.#limits.maxOf(this.#gear);
      delete request.torque_nm;
      delete request.shaft_speed_hz;
    }
    this.#requests.ask(request, wait);
  }

  #value({ input }, value = Number(input.value)) {
    return Number(value.toPrecision(6));
  }

  async #answered(preview, request) {
    if (!this.#gear) return;
    this.#onPreview(preview, request);
    const own = preview.refusals.find(({ field }) =>
      ["wear_um", "torque_nm", "shaft_speed_hz"].includes(field),
    );
    if (!preview.model) {
      this.#preview = undefined;
      const words = own ? own.detail : "The preview appears once the gear pair is valid.";
      // The sliders stay usable when one of them caused the error
      this.#showNotice(words);
      this.#wear.element.parentElement.inert = !own;
      if (preview.geometry && !own) this.#limits = undefined;
      return;
    }
    preview.model.base_radius_mm = preview.geometry.gears[1].base_radius_mm;
    this.#setLimits(preview, request);
    this.#preview = preview;
    this.#showNotice(null);
    await this.redraw();
  }

  #setLimits({ max_wear_um: most, model }, { gear }) {
    const key = pairKey(gear);
    if (this.#limits?.key === key) return;
    const began = !this.#limits;
    const { operation } = gear.pair;
    const module = gear.pair.geometry.module_mm;
    this.#limits = { key, maxOf: (other) => (most * (other.pair?.geometry.module_mm ?? module)) / module };
    const set = ({ input, show }, min, max, step, value) => {
      Object.assign(input, { min, max, step });
      input.value = value;
      show();
    };
    set(this.#wear, 0, most, most / WEAR_STEPS, model.wear_um);
    set(
      this.#torque,
      0.1 * operation.torque_nm,
      2 * operation.torque_nm,
      0.01 * operation.torque_nm,
      model.torque_nm,
    );
    set(
      this.#speed,
      0.1 * operation.shaft_speed_hz,
      2.5 * operation.shaft_speed_hz,
      0.01 * operation.shaft_speed_hz,
      model.shaft_speed_hz,
    );
    if (began) {
      this.#wear.input.value = BEGINNING * most;
      this.#wear.show();
      this.#ask();
    }
  }

  /** Redraws from known data. */
  async redraw() {
    if (!this.#preview) return;
    const { model, geometry } = this.#preview;
    const still = `${this.#limits.key} ${model.torque_nm} ${model.shaft_speed_hz}`;
    if (this.#extents.reset(still)) this.#makeRoom();
    this.#drawing.show(geometry, model.flanks, model.worn, this.#part);
    const rows = geometry.gears.map((gear, index) => ({ ...gear, ...model.flanks[index] }));
    this.#flanks.show({ gears: rows, wear_um: model.wear_um }, model);
    this.#showFacts(model);
    const name = `preview-${depth(model.wear_um)}-um`;
    const { harmonics, stiffness, transmission, waveform, spectrum } = this.#cards;
    const subject = () =>
      `${this.#owner ? `${this.#owner} · ` : ""}Simulated: ${pairWords(this.#gear)}, ${depth(model.wear_um)} µm deep, ${number(model.torque_nm, 4)} N m, ${hertz(model.shaft_speed_hz)}`;
    const framed = (drawing) => ({
      ...drawing,
      frame: `${still} ${palette().ink} ${drawing.traces.length} ${JSON.stringify(drawing.layout)}`,
    });
    const show = (card, plot, words) =>
      card.show(() => framed(plot(model, this.#extents)), `${name}-${words}`, subject);
    await Promise.all([
      show(harmonics, harmonicsPlot, "harmonics"),
      show(spectrum, spectrumPlot, "spectrum"),
      show(waveform, waveformPlot, "waveform"),
      show(stiffness, stiffnessPlot, "stiffness"),
      show(transmission, transmissionPlot, "transmission"),
    ]);
    this.element.dataset.wear = String(model.wear_um);
  }

  /** Sets axis ranges that fit every depth once torque and speed rest: changing an axis is slow to draw. */
  #makeRoom() {
    clearTimeout(this.#ahead);
    const extents = this.#extents;
    const { model } = this.#preview;
    const request = { gear: this.#gear, torque_nm: model.torque_nm, shaft_speed_hz: model.shaft_speed_hz };
    const key = extents.key;
    this.#ahead = setTimeout(async () => {
      try {
        for (let step = AHEAD; step > 0; step--) {
          const wear = this.#value(this.#wear, (step / AHEAD) * Number(this.#wear.input.max));
          const { model: deeper } = await api.preview({ ...request, wear_um: wear });
          if (extents.key !== key) return;
          if (deeper) extents.include({ ...deeper, base_radius_mm: model.base_radius_mm });
        }
        await this.redraw();
      } catch (error) {
        if (!(error instanceof api.ConnectionError)) throw error;
      }
    }, AHEAD_MS);
  }

  #showFacts({ unworn, worn, harmonics }) {
    const mean = ({ stiffness_n_per_m: values }) =>
      values.reduce((sum, value) => sum + value, 0) / values.length;
    const rms = ({ vibration }) => vibration.rms_m_per_s2;
    const strongest = harmonics.reduce((most, line) =>
      Math.abs(line.change_db) > Math.abs(most.change_db) ? line : most,
    );
    const percent = 100 * (mean(worn) / mean(unworn) - 1);
    const fact = (term, value, more) =>
      h("div", {}, h("dt", {}, term), h("dd", {}, value, h("span", { class: "muted" }, more)));
    setChildren(
      this.#facts,
      fact(
        "Vibration, RMS",
        `${decibels(20 * Math.log10(rms(worn) / rms(unworn)))} dB`,
        `${number(rms(worn), 3)} m/s²`,
      ),
      fact(
        `Mesh harmonic ${strongest.harmonic}×`,
        `${decibels(strongest.change_db)} dB`,
        hertz(strongest.frequency_hz),
      ),
      fact(
        "Mean stiffness",
        `${percent < -0.005 ? "−" : percent > 0.005 ? "+" : ""}${Math.abs(percent).toFixed(1)} %`,
        `${number(mean(worn) * 1e-6, 4)} N/µm`,
      ),
    );
  }

  #failed(error) {
    this.#onError(error);
    if (!this.#preview) this.#showNotice(`${error.message}.`);
  }

  #toggleRoll() {
    if (this.#rolling) return this.#stopRolling();
    this.#roll.setAttribute("aria-pressed", "true");
    setText(this.#roll, "⏸ Stop");
    let before = performance.now();
    const step = (now) => {
      this.#part = (this.#part + (now - before) / 1000 / ROLL_S) % 1;
      before = now;
      this.#drawing.turnTo(this.#part);
      this.#rolling = requestAnimationFrame(step);
    };
    this.#rolling = requestAnimationFrame(step);
  }

  #stopRolling() {
    cancelAnimationFrame(this.#rolling);
    this.#rolling = 0;
    this.#roll.setAttribute("aria-pressed", "false");
    setText(this.#roll, "▶ Roll teeth");
  }

  /** Releases the plots and stops requests. */
  dispose() {
    this.#stopRolling();
    clearTimeout(this.#ahead);
    this.#extents.reset(undefined);
    this.#requests.dispose();
    for (const card of Object.values(this.#cards)) card.dispose();
  }
}

/** A pair's name and teeth. */
const pairWords = ({ pair }) => `${pair.name ? `${pair.name}, ` : ""}${pair.geometry.teeth.join("/")} teeth`;

/** The data that a pair's limits depend on. */
function pairKey(gear) {
  return JSON.stringify(gear.pair);
}
