// Upload of files: each with its own start, then one after the other, with progress, and the server's refusal word for word.

import { address, failure } from "./api.js";
import { wavOfCsv } from "./csv-record.js";
import { h, setChildren, setText } from "./dom.js";
import { startOfFile } from "./file-start.js";
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
    request.open("POST", href);
    request.setRequestHeader("content-type", type);
    request.setRequestHeader("accept", "application/json");
    request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(loaded / total));
    request.addEventListener("load", () => (request.status < 300 ? resolve(JSON.parse(request.responseText)) : reject(failure(request.status, request.responseText))));
    request.addEventListener("error", () => reject(new Error("the connection was lost during the upload")));
    request.send(file);
  });
}

const OWN_TIMES = ["application/mcap", "application/json", "application/x-protobuf"]; // these say when each of their records began

const typeOf = (file) => TYPES[file.name.split(".").pop().toLowerCase()];

/** The upload part of the dialog: files are listed with their starts, and sent when that is asked for. */
export class UploadPanel {
  #assetId;
  #file = h("input", { type: "file", id: "upload-file", multiple: true, accept: ".wav,.mcap,.csv,.json,.pb", onchange: () => this.take([...this.#file.files]) });
  #unit = field("upload-unit", "Unit", { placeholder: "m/s2", size: 6 });
  #speed = field("upload-speed", "Shaft speed, Hz", { type: "number", min: 0, step: "any" });
  #rate = field("upload-rate", "Sampling rate of a CSV file, Hz", { type: "number", min: 0, step: "any", placeholder: "from its time column" });
  #torque = field("upload-torque", "Torque, N·m", { type: "number", step: "any" });
  #progress = h("progress", { max: 1, value: 0, hidden: true, "aria-label": "Upload" });
  #result;
  #chosen = new Map(); // file → the input of its start, null where the file says it itself
  #list = h("ul", { class: "files" });
  #send = h("button", { type: "button", class: "primary", hidden: true, onclick: () => this.#sendChosen() });
  #sending = Promise.resolve();
  #results = h("div", { class: "results", "aria-live": "polite" });
  element;

  constructor(assetId) {
    this.#assetId = assetId;
    const drop = h("label", { class: "drop", for: "upload-file" }, h("strong", {}, "Drop WAV, MCAP or CSV files here, or anywhere on the page"), h("span", {}, "or choose some:"), this.#file);
    // the page takes what is dropped, here as anywhere; this only shows that here is right
    drop.addEventListener("dragover", () => drop.classList.add("over"));
    for (const end of ["dragleave", "drop"]) drop.addEventListener(end, () => drop.classList.remove("over"));
    const fields = [this.#unit, this.#speed, this.#torque, this.#rate].map(({ element }) => element);
    const optional = h("details", {}, h("summary", {}, "For WAV and CSV files: unit, operating point, sampling rate"), h("div", { class: "fields" }, fields));
    this.element = h("section", {}, h("h3", {}, "Upload files"), optional, drop, this.#list, this.#send, this.#progress, this.#results);
  }

  #parameters(start) {
    return {
      unit: this.#unit.input.value.trim(),
      start_time: start && new Date(`${start}Z`).toISOString(),
      shaft_speed_hz: this.#speed.input.value,
      torque_nm: this.#torque.input.value,
    };
  }

  /** Lists files with their starts. */
  async take(files) {
    for (const file of files) {
      const type = typeOf(file);
      const start = type && !OWN_TIMES.includes(type) ? await startOfFile(file, type) : null;
      const input = start && h("input", { type: "datetime-local", step: "0.001", value: start.time.slice(0, -1), "aria-label": `Start of ${file.name}, UTC` });
      const words = !type ? "cannot be taken" : start ? start.source : "says itself when its records began";
      const item = h("li", {}, h("span", { class: "file-name" }, file.name, h("span", { class: "muted" }, ` ${bytes(file.size)}`)), this.#remover(file), input && h("label", { class: "field" }, h("span", {}, "Start, UTC"), input), h("span", { class: "muted" }, words));
      this.#chosen.set(file, input);
      this.#list.append(item);
    }
    this.#file.value = "";
    this.#offer();
  }

  #remover(file) {
    const remove = (event) => {
      this.#chosen.delete(file);
      event.currentTarget.closest("li").remove();
      this.#offer();
    };
    return h("button", { type: "button", class: "quiet", "aria-label": `Leave out ${file.name}`, onclick: remove }, "✕");
  }

  #offer() {
    const { size } = this.#chosen;
    this.#send.hidden = size === 0;
    setText(this.#send, size === 1 ? "Send the file" : `Send ${size} files`);
  }

  /** Sends what is listed one after the other, after what is under way, and says of each what became of it. */
  #sendChosen() {
    const files = [...this.#chosen].map(([file, input]) => [file, input?.value]);
    this.#chosen.clear();
    setChildren(this.#list);
    this.#offer();
    this.#sending = this.#sending.then(async () => {
      setChildren(this.#results);
      for (const [file, start] of files) {
        this.#result = h("div", { class: "result", role: "status" });
        this.#results.append(this.#result);
        await this.#upload(file, start);
      }
    });
  }

  async #upload(file, start) {
    const type = typeOf(file);
    if (!type) return this.#refused(file, new Error("expected a file that ends in .wav, .mcap, .csv, .json or .pb"));
    this.#progress.hidden = false;
    this.#progress.value = 0;
    setText(this.#result, `Sending ${file.name}, ${bytes(file.size)}…`);
    this.#result.dataset.kind = "";
    try {
      const converted = type === "text/csv" ? await wavOfCsv(file, Number(this.#rate.input.value)) : file;
      const sent = converted === file ? type : "audio/wav";
      const parameters = sent === "audio/wav" ? this.#parameters(start) : {};
      const href = address(["assets", this.#assetId, "segments"], parameters);
      const answer = await send(href, converted, sent, (share) => this.#sent(file, share));
      this.#accepted(file, answer);
      document.dispatchEvent(new CustomEvent("recordschange"));
    } catch (error) {
      this.#refused(file, error);
    } finally {
      this.#progress.hidden = true;
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
