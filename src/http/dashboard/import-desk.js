// The import panel: files are inspected, completed and uploaded together; a finished import can be undone.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { clock, count, some, speedDoubt } from "./format.js";
import { ImportBatch } from "./import-batch.js";
import { ImportFile } from "./import-file.js";
import { ENDINGS, unpacked } from "./import-preview.js";
import { UploadProgress } from "./import-progress.js";
import { refusalWords, sendFile } from "./import-sending.js";
import { StartSpacing } from "./import-spacing.js";
import { ImportValues } from "./import-values.js";
import { format } from "./route.js";

const UNFOLDED = 8; // files; the cards of more are folded

/** Makes the browser ask before the page is closed or reloaded, which would end an upload; until aborted. */
function warnBeforeLeaving() {
  const until = new AbortController();
  addEventListener("beforeunload", (event) => event.preventDefault(), { signal: until.signal });
  return until;
}

const changed = () => document.dispatchEvent(new CustomEvent("recordschange"));
const records = (n) => some(n, "record");

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
  #values = new ImportValues(() => this.#lookAgain());
  #spacing = new StartSpacing(() => {
    this.#compare();
    this.#fold(this.#files);
  });
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
    // The page handles all drops; this area only marks where to drop
    drop.addEventListener("dragover", () => drop.classList.add("over"));
    for (const end of ["dragleave", "drop"]) drop.addEventListener(end, () => drop.classList.remove("over"));
    this.element = h(
      "section",
      { class: "import-desk" },
      h("h3", {}, "Upload files"),
      this.#values.element,
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

  /** Lists files and inspects them one after the other. */
  async take(chosen) {
    // A file that cannot be unpacked is shown as unsupported
    const files = await Promise.all(chosen.map((file) => unpacked(file).catch(() => file)));
    const cards = files.map(
      (file) =>
        new ImportFile(
          file,
          this.#asset,
          () => this.#values.common(),
          (card) => this.#remove(card),
          () => this.#showChange(),
        ),
    );
    this.#files.push(...cards);
    this.#list.append(...cards.map(({ element }) => element));
    this.#file.value = "";
    for (const card of cards) await card.look();
    this.#fold(cards);
    if (this.#files.some(({ lacksUnit }) => lacksUnit)) await this.#values.askForUnit(this.#asset);
    this.#offer(); // files not inspected yet are not sent
  }

  #fold(cards) {
    if (this.#files.length > UNFOLDED) for (const card of cards) card.fold();
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
    this.#offer();
  }

  #remove(card) {
    this.#files = this.#files.filter((other) => other !== card);
    card.element.remove();
    this.#offer();
    this.#compare();
  }

  /** Says how far the upload is; `repeated` counts records that were stored already. */
  #sum(done, all, { rejected, unsent, repeated }, isLast) {
    this.#summary.hidden = all < 2;
    const refused = [
      rejected.length ? `, ${some(rejected.length, "file")} rejected` : "",
      unsent.length ? `, ${some(unsent.length, "file")} not sent` : "",
    ].join("");
    const known = repeated ? `, ${count(repeated)} already stored` : "";
    this.#summary.dataset.kind = !isLast ? "" : refused ? "part" : "good";
    setText(
      this.#summary,
      isLast
        ? `${some(all - unsent.length, "file")} read: ${records(this.#batch.size)} added${known}${refused}.`
        : `${count(done)} of ${count(all)} files uploaded${refused}…`,
    );
  }

  /** After an inspection or an entry: asks for a missing sampling rate, and compares the files. */
  #showChange() {
    if (this.#files.some(({ seen }) => seen?.lacksRate)) this.#values.element.open = true;
    this.#compare();
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
    const { length } = this.#files.filter(({ isRecording }) => isRecording);
    this.#spacing.show(this.#files);
    this.#send.hidden = length === 0;
    setText(this.#send, length === 1 ? "Upload file" : `Upload ${length} files`);
  }

  /**
   * Uploads the listed files one after the other, after any running upload, and reports the result of each.
   * Unsupported files stay listed, with their reason.
   */
  #sendAll() {
    if (!this.#files.some(({ isRecording }) => isRecording) || this.#failBroken()) return;
    const common = this.#values.common();
    const questions = [
      this.#spacing.question(),
      this.#futureQuestion(),
      this.#unitQuestion(),
      this.#unusedQuestion(common),
    ];
    if (!questions.filter(Boolean).every((question) => confirm(question))) return;
    const cards = this.#files
      .filter(({ isRecording }) => isRecording)
      .map((card) => ({ card, file: card.file, seen: card.seen, entry: card.entry() }));
    this.#files = this.#files.filter(({ isRecording }) => !isRecording);
    this.#values.forgetUnit();
    setChildren(
      this.#list,
      this.#files.map(({ element }) => element),
    );
    this.#offer();
    this.#sending = this.#sending.then(async () => {
      setChildren(this.#results);
      setText(this.#undone, "");
      this.#undo.hidden = this.#next.hidden = this.#question.hidden = true;
      this.#batch.begin();
      const stay = warnBeforeLeaving();
      const waiting = cards.map(({ file }) => new UploadProgress(file));
      this.#results.append(...waiting.map(({ element }) => element));
      const results = { rejected: [], unsent: [], repeated: 0 };
      for (const [n, one] of cards.entries()) {
        this.#sum(n, cards.length, results, false);
        await this.#sendOne(one, common, waiting[n], results);
      }
      this.#sum(cards.length, cards.length, results, true);
      this.#listAgain(results);
      stay.abort();
      this.#next.hidden = !this.#next.children.length || this.#batch.size === 0;
      this.#offerUndo();
      await this.#askAboutSpeed();
    });
  }

  /** A question when a record would start in the future, which the server refuses beyond its limit. */
  #futureQuestion() {
    const startOf = (card) => card.start() ?? card.seen.ownStart;
    const ahead = this.#files.find((card) => card.isRecording && Date.parse(startOf(card)) > Date.now());
    return ahead ? `${ahead.file.name} starts in the future, at ${clock(startOf(ahead))}. Upload it?` : null;
  }

  /** A question before the first records of an asset whose unit nobody has entered; null otherwise. */
  #unitQuestion() {
    const lacking = this.#files.find(({ isRecording, lacksEnteredUnit }) => isRecording && lacksEnteredUnit);
    return lacking && this.#values.lackUnit
      ? `The samples of ${lacking.file.name} have no unit, and it cannot be changed once a channel has records. Upload without a unit?`
      : null;
  }

  /** A question when an entered value does not apply to a file; null otherwise. */
  #unusedQuestion(common) {
    const unused = this.#files.flatMap((card) =>
      card.isRecording
        ? card.unused(common).map((words) => `${card.file.name} does not use the ${words}.`)
        : [],
    );
    const more = unused.length > 1 ? ` (and ${count(unused.length - 1)} more)` : "";
    return unused.length ? `${unused[0]}${more} Upload without it?` : null;
  }

  /** Shows the times in another time zone. */
  changeZone() {
    this.#spacing.changeZone();
    for (const card of this.#files) card.changeZone();
    this.#offerUndo();
  }

  /** Shows an error at a number field that contains something else; returns whether there is one. */
  #failBroken() {
    const broken = [this.#values, ...this.#files].map((part) => part.broken).find(Boolean);
    if (!broken) return false;
    broken.closest("details").open = true;
    broken.setAttribute("aria-invalid", "true");
    broken.addEventListener("input", () => broken.removeAttribute("aria-invalid"), { once: true });
    broken.focus();
    const name = broken.ariaLabel ?? broken.labels[0].textContent;
    this.#showNotice("bad", `Nothing was uploaded: “${name}” is not a number.`);
    return true;
  }

  /** Lists files again that were not sent, and rejected ones if another start, rate or name may help. */
  #listAgain({ rejected, unsent }) {
    const readable = rejected.filter(({ isReadable }) => isReadable);
    const cards = [...readable, ...unsent];
    if (cards.length === 0) return;
    this.#files.unshift(...cards);
    this.#list.prepend(...cards.map(({ element }) => element));
    this.#summary.hidden = false;
    if (readable.length) this.#summary.append(" Rejected files are listed again, to be corrected.");
    if (unsent.length) this.#summary.append(" Files that were not sent are listed again.");
    this.#offer();
    this.#compare();
  }

  /** Adds the card of a rejected file, or of one that did not reach the server, to the results. */
  async #sendOne({ card, file, seen, entry }, common, progress, results) {
    progress.begin();
    try {
      const { kind, words, segments, listed, repeated } = await sendFile(
        this.#asset,
        file,
        seen,
        entry,
        common,
        (share) => progress.sent(share),
      );
      this.#batch.add(segments);
      results.repeated += repeated;
      progress.end(
        kind,
        listed ? words : [...words, `Only its first ${count(segments.length)} records can be deleted here.`],
      );
      changed();
      if (kind === "bad") results.rejected.push(card);
    } catch (error) {
      progress.end("bad", refusalWords(file.name, error));
      (error instanceof api.ConnectionError ? results.unsent : results.rejected).push(card);
    }
  }

  async #undoImport() {
    const { size } = this.#batch;
    if (
      !confirm(
        `Delete the ${records(size)} of this import? The wear history is then recomputed without ${size === 1 ? "it" : "them"}.`,
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
