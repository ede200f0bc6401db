// The import panel: files are inspected, completed and uploaded together; a finished import can be undone.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { bytes, clock, count, speedDoubt } from "./format.js";
import { ImportBatch } from "./import-batch.js";
import { ImportFile } from "./import-file.js";
import { ENDINGS, unpacked } from "./import-preview.js";
import { refusalWords, sendFile } from "./import-sending.js";
import { StartSpacing } from "./import-spacing.js";
import { UNITS, unitList, unknownUnitWords } from "./known-units.js";
import { format } from "./route.js";

function field(id, label, properties) {
  const input = h("input", { id, ...properties });
  return { input, element: h("label", { class: "field", for: id }, h("span", {}, label), input) };
}

/** Makes the browser ask before the page is closed or reloaded, which would end an upload; until aborted. */
function warnBeforeLeaving() {
  const until = new AbortController();
  addEventListener("beforeunload", (event) => event.preventDefault(), { signal: until.signal });
  return until;
}

const changed = () => document.dispatchEvent(new CustomEvent("recordschange"));
const records = (n) => `${count(n)} ${n === 1 ? "record" : "records"}`;

/** The import panel of one asset. */
export class ImportDesk {
  #asset;
  #files = [];
  #file = h("input", {
    type: "file",
    id: "upload-file",
    multiple: true,
    accept: [...ENDINGS, ".gz"].join(","),
    onchange: () => this.take([...this.#file.files]),
  });
  #unit = field("upload-unit", "Unit", {
    placeholder: "e.g. m/s2",
    size: 6,
    list: UNITS,
    onchange: () => this.#checkUnit(),
  });
  #speed = field("upload-speed", "Shaft speed, Hz", { type: "number", min: 0, step: "any" });
  #torque = field("upload-torque", "Torque, N·m", { type: "number", step: "any" });
  #temperature = field("upload-temperature", "Temperature, °C", { type: "number", step: "any" });
  #rate = field("upload-rate", "Sampling rate of a CSV, MATLAB or NumPy file, Hz", {
    type: "number",
    min: 0,
    step: "any",
    placeholder: "from the file",
    onchange: () => this.#lookAgain(),
  });
  #scale = field("upload-scale", "Full scale of 16-bit WAV files, in the unit", {
    type: "number",
    min: 0,
    step: "any",
    placeholder: "1",
    title: "The amplitude of the largest 16-bit value, for example 50 for ±50 m/s²",
  });
  #unitNote = h(
    "p",
    { class: "result", "data-kind": "part", hidden: true },
    "The files do not name the unit of their samples, and the asset has no default. Enter it (m/s2, g, mm/s …): without it levels have no unit and velocity is not computed. It cannot be changed once a channel has records.",
  );
  #unknownUnit = h("p", { class: "result", "data-kind": "part", role: "status", hidden: true });
  #optional;
  #spacing = new StartSpacing(() => this.#compare());
  #list = h("ul", { class: "files" });
  #send = h("button", { type: "button", class: "primary", hidden: true, onclick: () => this.#sendAll() });
  #sending = Promise.resolve();
  #summary = h("p", { class: "result", hidden: true });
  #next = h("p", { class: "next-step", hidden: true });
  #question = h("p", { class: "result", "data-kind": "part", role: "status", hidden: true });
  #results = h("div", { class: "results", "aria-live": "polite" });
  #undo = h(
    "button",
    { type: "button", hidden: true, onclick: () => this.#undoImport() },
    "Undo this import…",
  );
  #undone = h("p", { class: "result", role: "status" });
  #batch;
  element;

  /** `isOnPage` offers the way to the asset's overview after an import; a dialog is closed instead. */
  constructor(asset, { isOnPage = false } = {}) {
    this.#asset = asset;
    if (isOnPage)
      this.#next.append(
        h("a", { class: "button", href: format({ page: "asset", id: asset }) }, "Show the results"),
      );
    this.#batch = new ImportBatch(asset);
    const drop = h(
      "label",
      { class: "drop", for: "upload-file" },
      h("strong", {}, "Drop recordings or folders of them here or anywhere on the page"),
      h("span", {}, "WAV, FLAC, CSV, MATLAB, NumPy, MCAP"),
      h("span", {}, "or select files:"),
      this.#file,
    );
    // the page handles all drops; this area only marks where to drop
    drop.addEventListener("dragover", () => drop.classList.add("over"));
    for (const end of ["dragleave", "drop"]) drop.addEventListener(end, () => drop.classList.remove("over"));
    const fields = [this.#unit, this.#scale, this.#speed, this.#torque, this.#temperature, this.#rate].map(
      ({ element }) => element,
    );
    this.#optional = h(
      "details",
      {},
      h("summary", {}, "Unit; for all files other than MCAP: full scale, operating point, sampling rate"),
      this.#unitNote,
      h("div", { class: "fields" }, fields),
      this.#unknownUnit,
      unitList(),
    );
    this.element = h(
      "section",
      { class: "import-desk" },
      h("h3", {}, "Upload files"),
      this.#optional,
      drop,
      this.#spacing.element,
      this.#list,
      h("div", { class: "form-buttons" }, this.#send, this.#undo),
      this.#undone,
      this.#summary,
      this.#next,
      this.#question,
      this.#results,
    );
    this.#offerUndo();
  }

  #offerUndo() {
    const { since, size } = this.#batch;
    this.#undo.hidden = size === 0;
    const which = since ? `the import of ${clock(since, { toMinute: true })}` : "this import";
    setText(this.#undo, `Undo ${which}: delete ${records(size)}…`);
  }

  /** Values for all files that do not contain them. */
  #common() {
    return {
      unit: this.#unit.input.value.trim(),
      shaft_speed_hz: this.#speed.input.value,
      torque_nm: this.#torque.input.value,
      temperature_c: this.#temperature.input.value,
      rate: Number(this.#rate.input.value) || undefined,
      fullScale: Number(this.#scale.input.value) || undefined,
    };
  }

  /** Lists files and inspects them one after the other. */
  async take(chosen) {
    // a file that cannot be unpacked is shown as unsupported
    const files = await Promise.all(chosen.map((file) => unpacked(file).catch(() => file)));
    const cards = files.map(
      (file) =>
        new ImportFile(
          file,
          this.#asset,
          () => this.#common(),
          (card) => this.#remove(card),
          () => this.#compare(),
        ),
    );
    this.#files.push(...cards);
    this.#list.append(...cards.map(({ element }) => element));
    this.#file.value = "";
    for (const card of cards) await card.look();
    await this.#askForUnit();
    this.#offer(); // files not inspected yet are not sent
  }

  /** Points to the field of the unit before the first records of an asset, whose unit then stays. */
  async #askForUnit() {
    if (this.#unit.input.value || !this.#files.some(({ lacksUnit }) => lacksUnit)) return;
    const asset = await api.asset(this.#asset).catch(() => null);
    if (!asset || asset.sensor?.unit || asset.summary.segments > 0) return;
    this.#unitNote.hidden = false;
    this.#optional.open = true;
  }

  #checkUnit() {
    const words = unknownUnitWords(this.#unit.input.value.trim());
    this.#unknownUnit.hidden = !words;
    setText(this.#unknownUnit, words);
  }

  /** After an upload, asks whether teeth and speed are right if the lines of the latest record contradict them. */
  async #askAboutSpeed() {
    const latest = await api.wear(this.#asset).catch(() => null);
    const doubt = latest?.shaft_speed ? speedDoubt(latest.shaft_speed) : null;
    this.#question.hidden = !doubt;
    setText(this.#question, doubt ? `The speed of the latest record is ${doubt}` : "");
  }

  async #lookAgain() {
    const depend = ["text/csv", "application/x-matlab-data", "application/x-npy"];
    for (const card of this.#files.filter(({ seen }) => !seen || depend.includes(seen.type)))
      await card.look();
  }

  #remove(card) {
    this.#files = this.#files.filter((other) => other !== card);
    card.element.remove();
    this.#offer();
    this.#compare();
  }

  /** Says how far the upload is; `rejected` files are not stored. */
  #sum(done, all, rejected, isLast) {
    this.#summary.hidden = all < 2;
    const refused = rejected ? `, ${count(rejected)} ${rejected === 1 ? "file" : "files"} rejected` : "";
    this.#summary.dataset.kind = !isLast ? "" : rejected ? "part" : "good";
    setText(
      this.#summary,
      isLast
        ? `${count(all)} files read: ${records(this.#batch.size)} added${refused}.`
        : `${count(done)} of ${count(all)} files uploaded${refused}…`,
    );
  }

  /** Marks the files whose records would have the same start and channel. */
  #compare() {
    const places = this.#files.map((card) => new Set(card.places()));
    for (const [n, card] of this.#files.entries()) {
      const twins = this.#files.filter((_, m) => m !== n && !places[n].isDisjointFrom(places[m]));
      card.showTwins(twins.map(({ file }) => file.name));
    }
  }

  #offer() {
    const { length } = this.#files;
    this.#spacing.show(this.#files);
    this.#send.hidden = length === 0;
    setText(this.#send, length === 1 ? "Upload file" : `Upload ${length} files`);
  }

  /**
   * Uploads the listed files one after the other, after any running upload, and reports the result of each.
   */
  #sendAll() {
    const common = this.#common();
    const cards = this.#files
      .filter(({ seen }) => seen)
      .map((card) => ({ file: card.file, seen: card.seen, entry: card.entry() }));
    this.#files = [];
    this.#unitNote.hidden = true;
    setChildren(this.#list);
    this.#offer();
    this.#sending = this.#sending.then(async () => {
      setChildren(this.#results);
      setText(this.#undone, "");
      this.#undo.hidden = this.#next.hidden = this.#question.hidden = true;
      this.#batch.begin();
      const stay = warnBeforeLeaving();
      const waiting = cards.map(({ file }) => new Progress(file));
      this.#results.append(...waiting.map(({ element }) => element));
      let rejected = 0;
      for (const [n, card] of cards.entries()) {
        this.#sum(n, cards.length, rejected, false);
        if (!(await this.#sendOne(card, common, waiting[n]))) rejected += 1;
      }
      this.#sum(cards.length, cards.length, rejected, true);
      stay.abort();
      this.#next.hidden = !this.#next.children.length || this.#batch.size === 0;
      this.#offerUndo();
      await this.#askAboutSpeed();
    });
  }

  /** Returns whether the file was taken. */
  async #sendOne({ file, seen, entry }, common, progress) {
    if (!seen.type) {
      progress.end("bad", refusalWords(file, new Error(seen.fault)));
      return false;
    }
    progress.begin();
    try {
      const { kind, words, segments, listed } = await sendFile(
        this.#asset,
        file,
        seen,
        entry,
        common,
        (share) => progress.sent(share),
      );
      this.#batch.add(segments);
      progress.end(
        kind,
        listed ? words : [...words, `Only its first ${count(segments.length)} records can be deleted here.`],
      );
      changed();
      return kind !== "bad";
    } catch (error) {
      progress.end("bad", refusalWords(file, error));
      return false;
    }
  }

  async #undoImport() {
    const { size } = this.#batch;
    if (
      !confirm(
        `Delete the ${records(size)} of this import? The wear history is then recomputed without them.`,
      )
    )
      return;
    this.#undo.disabled = true;
    try {
      const gone = await this.#batch.undo();
      setChildren(this.#results);
      this.#summary.hidden = this.#next.hidden = this.#question.hidden = true;
      this.#showNotice("good", `${records(gone)} deleted. Import undone.`);
    } catch (error) {
      const left = size - this.#batch.size;
      this.#showNotice("bad", `Undo failed${left ? ` after ${records(left)}` : ""}: ${error.message}.`);
    } finally {
      this.#offerUndo();
      this.#undo.disabled = false;
      changed();
    }
  }

  #showNotice(kind, words) {
    this.#undone.dataset.kind = kind;
    setText(this.#undone, words);
  }
}

/** Progress and result of one upload. */
class Progress {
  #file;
  #words = h("p", {});
  #bar = h("progress", { max: 1, value: 0, hidden: true });
  element;

  constructor(file) {
    this.#file = file;
    this.#bar.setAttribute("aria-label", `Upload of ${file.name}`);
    setText(this.#words, `${file.name}: waiting.`);
    this.element = h("div", { class: "result", role: "status" }, this.#words, this.#bar);
  }

  begin() {
    this.#bar.hidden = false;
    setText(this.#words, `Uploading ${this.#file.name}, ${bytes(this.#file.size)}…`);
  }

  sent(share) {
    if (share < 1) return (this.#bar.value = share);
    // all bytes are sent; the answer arrives once every record is analysed and stored
    this.#bar.removeAttribute("value");
    setText(this.#words, `${this.#file.name}: uploaded, analysing…`);
  }

  end(kind, words) {
    this.element.dataset.kind = kind;
    setChildren(this.element, ...words.map((text) => h("p", {}, text)));
  }
}
