// Upload of files, one after the other, with progress, and the server's refusal word for word.

import { address, authorization, failure } from "./api.js";
import { wavOfCsv } from "./csv-record.js";
import { h, setChildren, setText } from "./dom.js";
import { bytes, depth, utc } from "./format.js";

const TYPES = { wav: "audio/wav", csv: "text/csv", mcap: "application/mcap", json: "application/json", pb: "application/x-protobuf" };

function field(id, label, properties) {
  const input = h("input", { id, ...properties });
  return { input, element: h("label", { class: "field", for: id }, h("span", {}, label), input) };
}

/** Sends a file and reports how much of it is gone; fetch has no progress of an upload. */
function send(href, file, type, onProgress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const fields = Object.entries(authorization());
    request.open("POST", href);
    for (const [name, value] of fields) request.setRequestHeader(name, value);
    request.setRequestHeader("content-type", type);
    request.setRequestHeader("accept", "application/json");
    request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(loaded / total));
    request.addEventListener("load", () => (request.status < 300 ? resolve(JSON.parse(request.responseText)) : reject(failure(request.status, request.responseText))));
    request.addEventListener("error", () => reject(new Error("the connection was lost during the upload")));
    request.send(file);
  });
}

/** The upload part of the dialog. */
export class UploadPanel {
  #assetId;
  #file = h("input", { type: "file", id: "upload-file", multiple: true, accept: ".wav,.mcap,.csv,.json,.pb", onchange: () => this.take([...this.#file.files]) });
  #unit = field("upload-unit", "Unit", { placeholder: "m/s2", size: 6 });
  #start = field("upload-start", "Start, UTC", { type: "datetime-local", step: 1 });
  #speed = field("upload-speed", "Shaft speed, Hz", { type: "number", min: 0, step: "any" });
  #rate = field("upload-rate", "Sampling rate of a CSV file, Hz", { type: "number", min: 0, step: "any", placeholder: "from its time column" });
  #torque = field("upload-torque", "Torque, N·m", { type: "number", step: "any" });
  #progress = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Upload" });
  #result;
  #sending = Promise.resolve();
  #results = h("div", { class: "results", "aria-live": "polite" });
  element;

  constructor(assetId) {
    this.#assetId = assetId;
    const drop = h("label", { class: "drop", for: "upload-file" }, h("strong", {}, "Drop WAV, MCAP or CSV files here, or anywhere on the page"), h("span", {}, "or choose some:"), this.#file);
    // the page takes what is dropped, here as anywhere; this only shows that here is right
    drop.addEventListener("dragover", () => drop.classList.add("over"));
    for (const end of ["dragleave", "drop"]) drop.addEventListener(end, () => drop.classList.remove("over"));
    const fields = [this.#unit, this.#start, this.#speed, this.#torque, this.#rate].map(({ element }) => element);
    const optional = h("details", {}, h("summary", {}, "For WAV and CSV files: unit, start time, operating point, sampling rate"), h("div", { class: "fields" }, fields));
    this.element = h("section", {}, h("h3", {}, "Upload a file"), optional, drop, this.#progress, this.#results);
  }

  #parameters() {
    const start = this.#start.input.value;
    return {
      unit: this.#unit.input.value.trim(),
      start_time: start && new Date(`${start}Z`).toISOString(),
      shaft_speed_hz: this.#speed.input.value,
      torque_nm: this.#torque.input.value,
    };
  }

  /** Sends files one after the other, after those that are under way, and says of each what became of it. */
  take(files) {
    this.#sending = this.#sending.then(() => this.#take(files));
    return this.#sending;
  }

  async #take(files) {
    setChildren(this.#results);
    for (const file of files) {
      this.#result = h("div", { class: "result", role: "status" });
      this.#results.append(this.#result);
      await this.#upload(file);
    }
  }

  async #upload(file) {
    const type = TYPES[file.name.split(".").pop().toLowerCase()];
    if (!type) return this.#refused(file, new Error("expected a file that ends in .wav, .mcap, .csv, .json or .pb"));
    this.#progress.hidden = false;
    this.#progress.value = 0;
    setText(this.#result, `Sending ${file.name}, ${bytes(file.size)}…`);
    this.#result.dataset.kind = "";
    try {
      const converted = type === "text/csv" ? await wavOfCsv(file, Number(this.#rate.input.value)) : file;
      const sent = converted === file ? type : "audio/wav";
      const parameters = sent === "audio/wav" ? this.#parameters() : {};
      const href = address(["assets", this.#assetId, "segments"], parameters);
      const answer = await send(href, converted, sent, (share) => this.#sent(file, share));
      this.#accepted(file, answer);
      document.dispatchEvent(new CustomEvent("recordschange"));
    } catch (error) {
      this.#refused(file, error);
    } finally {
      this.#progress.hidden = true;
      this.#file.value = "";
    }
  }

  #sent(file, share) {
    if (share < 1) return (this.#progress.value = share);
    // all bytes are gone, and the answer comes when every record is analysed and kept
    this.#progress.removeAttribute("value");
    setText(this.#result, `${file.name} is sent; the service is analysing it…`);
  }

  #accepted(file, answer) {
    this.#result.dataset.kind = !answer.refused_count ? "good" : answer.stored + answer.repeated + (answer.queued ?? 0) > 0 ? "part" : "bad";
    setChildren(this.#result, ...words(file, answer).map((text) => h("p", {}, text)));
  }

  #refused(file, error) {
    this.#result.dataset.kind = "bad";
    const { field: name, value, expected } = error.problem ?? {};
    const parts = [`${file.name} was not taken: ${error.message}`];
    if (expected && !error.message.includes(expected)) parts.push(`${name ?? "value"} is ${JSON.stringify(value ?? null)}, expected ${expected}`);
    setChildren(this.#result, parts.map((text) => h("p", {}, text)));
  }
}

function words(file, answer) {
  if (answer.records !== undefined) {
    const queued = answer.queued ? `, ${answer.queued} taken and waiting to be analysed` : "";
    const counts = `${file.name}: ${answer.records} records read, ${answer.stored} stored${queued}, ${answer.repeated} already known, ${answer.refused_count} refused.`;
    return [counts, ...answer.refused.slice(0, 5).map(({ record, channel, reason }) => `Record ${record}${channel ? `, channel ${channel}` : ""}: ${reason}.`)];
  }
  const segments = answer.segments ?? [answer];
  return segments.map(({ channel, start_time: start, wear, state }) => {
    if (state === "queued") return `${file.name}: channel ${channel} taken as the record of ${utc(start)}; it waits to be analysed, and its wear shows up on the page by itself.`;
    const estimate = wear.median_um == null ? wear.reason : `wear ${depth(wear.median_um)} µm (${depth(wear.p05_um)} to ${depth(wear.p95_um)})`;
    return `${file.name}: channel ${channel} stored as the record of ${utc(start)}; ${estimate}.`;
  });
}
