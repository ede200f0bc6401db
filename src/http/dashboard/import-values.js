// What the import panel asks once for all files: unit, full scale, operating point, sampling rate.

import * as api from "./api.js";
import { h, setText } from "./dom.js";
import { tidy } from "./field-values.js";
import { UNITS, unitList, unknownUnitWords } from "./known-units.js";

function field(id, label, properties) {
  const input = h("input", { id, ...properties });
  return { input, element: h("label", { class: "field", for: id }, h("span", {}, label), input) };
}

/** Values for files that do not contain them; `onRate` is called when the sampling rate changes. */
export class ImportValues {
  #unit = field("upload-unit", "Unit", {
    placeholder: "e.g. m/s2",
    size: 6,
    list: UNITS,
    onchange: () => this.#checkUnit(),
  });
  #speed = field("upload-speed", "Shaft speed, rpm", { type: "number", min: 0, step: "any" });
  #torque = field("upload-torque", "Torque, N·m", { type: "number", step: "any" });
  #temperature = field("upload-temperature", "Temperature, °C", { type: "number", step: "any" });
  #rate = field("upload-rate", "Sampling rate of a CSV, MATLAB or NumPy file, Hz", {
    type: "number",
    min: 0,
    step: "any",
    placeholder: "from the file",
    onchange: () => this.#onRate(),
  });
  #scale = field("upload-scale", "Full scale of integer WAV and FLAC files, in the unit", {
    type: "number",
    min: 0,
    step: "any",
    placeholder: "1",
    title: "The amplitude of the largest integer: 50 for ±50 m/s², or 5 for ±5 V with a sensitivity",
  });
  #sensitivity = field("upload-sensitivity", "Sensitivity of the sensor, mV/g", {
    type: "number",
    min: 0,
    step: "any",
    placeholder: "not in volts",
    onchange: () => this.#checkUnit(),
    title: "For samples in volts: converts them to g",
  });
  #unitNote = h(
    "p",
    { class: "result", "data-kind": "part", hidden: true },
    "The files do not name the unit of their samples, and the asset has no default. Enter it (m/s2, g, mm/s …): without it levels have no unit and velocity is not computed. It cannot be changed once a channel has records.",
  );
  #unknownUnit = h("p", { class: "result", "data-kind": "part", role: "status", hidden: true });
  #isUnitAsked = false;
  #onRate;
  element;

  constructor(onRate) {
    this.#onRate = onRate;
    const fields = [this.#unit, ...this.#numbers].map(({ element }) => element);
    this.element = h(
      "details",
      {},
      h(
        "summary",
        {},
        "Details missing from the files (unit; except MCAP also full scale, sampling rate, speed, load)",
      ),
      this.#unitNote,
      h("div", { class: "fields" }, fields),
      this.#unknownUnit,
      unitList(),
    );
  }

  get #numbers() {
    return [this.#scale, this.#sensitivity, this.#speed, this.#torque, this.#temperature, this.#rate];
  }

  /** The first number field that contains something else, which would count as empty. */
  get broken() {
    return this.#numbers.map(({ input }) => input).find(({ validity }) => validity.badInput);
  }

  /** Values for all files that do not contain them. */
  common() {
    const speed = this.#speed.input.value;
    return {
      unit: this.#unit.input.value.trim(),
      shaft_speed_hz: speed && tidy(Number(speed) / 60),
      torque_nm: this.#torque.input.value,
      temperature_c: this.#temperature.input.value,
      rate: Number(this.#rate.input.value) || undefined,
      fullScale: Number(this.#scale.input.value) || undefined,
      sensitivity: Number(this.#sensitivity.input.value) || undefined,
    };
  }

  /** Points to the field of the unit before the first records of an asset, whose unit then stays. */
  async askForUnit(id) {
    if (this.#unit.input.value) return;
    const asset = await api.asset(id).catch(() => null);
    if (!asset || asset.sensor?.unit || asset.summary.segments > 0) return;
    this.#isUnitAsked = true;
    this.#checkUnit();
    this.element.open = true;
  }

  /** Once files are sent, their channels have a unit, or stay without one. */
  forgetUnit() {
    this.#isUnitAsked = false;
    this.#checkUnit();
  }

  /** Whether the first records of an asset would have no unit; a sensitivity gives them one. */
  get lackUnit() {
    return this.#isUnitAsked && !this.#unit.input.value.trim() && !this.#sensitivity.input.value;
  }

  #checkUnit() {
    this.#unitNote.hidden = !this.lackUnit;
    const words = unknownUnitWords(this.#unit.input.value.trim());
    this.#unknownUnit.hidden = !words;
    setText(this.#unknownUnit, words);
  }
}
