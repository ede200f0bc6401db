// Replays of recordings in the server's folder: start, progress, stop.

import { ApiError, replayFiles, replays, startReplay, stopReplay } from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { bytes, count, number } from "./format.js";
import { KeyedRows } from "./keyed-rows.js";

const PACES = [
  ["max", "as fast as possible"],
  ["10x", "ten times real time"],
  ["realtime", "real time"],
];

const MAX_FILES = 1000; // files that the service lists
const BY_NAME = ""; // the choice of a file that is not listed

/** The replay section of the dialog. */
export class ReplayPanel {
  #assetId;
  #file = h("select", { id: "replay-file", required: true, onchange: () => this.#choose() });
  #name = h("input", { id: "replay-name", placeholder: "run.mcap", autocomplete: "off" });
  #named = h(
    "label",
    { class: "field", for: "replay-name", hidden: true },
    h("span", {}, "Name in the replay folder"),
    this.#name,
  );
  #form;
  #empty = h(
    "p",
    { class: "muted", hidden: true },
    "The replay folder contains no recordings. It is the folder “recordings” in the data folder of the service, or the one set with --replay-dir.",
  );
  #pace = h(
    "select",
    { id: "replay-pace" },
    PACES.map(([value, label]) => h("option", { value }, label)),
  );
  #error = h("p", { class: "result", "data-kind": "bad", role: "status", hidden: true });
  #list = h("ul", { class: "replays" });
  #rows = new KeyedRows(
    this.#list,
    ({ id }) => id,
    (replay) => this.#item(replay),
  );
  #shown;
  #isRefused = false; // the latest request for the replays
  element;

  constructor(assetId) {
    this.#assetId = assetId;
    this.#form = h(
      "form",
      { class: "fields", onsubmit: (event) => this.#start(event) },
      h(
        "label",
        { class: "field", for: "replay-file" },
        h("span", {}, "File in the replay folder"),
        this.#file,
      ),
      this.#named,
      h("label", { class: "field", for: "replay-pace" }, h("span", {}, "Pace"), this.#pace),
      h("button", { type: "submit" }, "Start replay"),
    );
    this.element = h(
      "section",
      {},
      h("h3", {}, "Replay a recording on the server"),
      this.#form,
      this.#empty,
      this.#error,
      this.#list,
    );
    this.#listFiles();
  }

  /** Lists the available files. A name can be entered only when some may be missing from the list. */
  async #listFiles() {
    const response = await replayFiles().catch(() => null);
    const items = response?.items ?? [];
    const isWhole = response && items.length < MAX_FILES;
    const chosen = this.#file.value;
    this.#empty.hidden = !response || items.length > 0;
    this.#form.hidden = isWhole && items.length === 0;
    setChildren(
      this.#file,
      items.map(({ file, bytes: size }) => h("option", { value: file }, `${file}, ${bytes(size)}`)),
      isWhole ? null : h("option", { value: BY_NAME }, "Another file, by name…"),
    );
    if (items.some(({ file }) => file === chosen)) this.#file.value = chosen;
    this.#choose();
  }

  #choose() {
    const isNamed = this.#file.value === BY_NAME;
    this.#named.hidden = !isNamed;
    this.#name.required = isNamed;
  }

  async #start(event) {
    event.preventDefault();
    const file = this.#file.value === BY_NAME ? this.#name.value.trim() : this.#file.value;
    await this.#try(() => startReplay({ asset: this.#assetId, file, pace: this.#pace.value }));
  }

  async #try(action) {
    this.#error.hidden = true;
    try {
      await action();
      await this.refresh();
    } catch (error) {
      this.#fail(error);
    }
  }

  #fail(error) {
    this.#error.hidden = false;
    setText(this.#error, error.message);
  }

  /** Fetches this asset's replays. The page reports a lost connection. */
  async refresh() {
    let response;
    try {
      response = await replays();
    } catch (error) {
      this.#isRefused = error instanceof ApiError;
      if (this.#isRefused) this.#fail(error);
      return;
    }
    if (this.#isRefused) this.#error.hidden = true;
    this.#isRefused = false;
    if (response === this.#shown) return;
    this.#shown = response;
    const own = response.items.filter((replay) => replay.asset === this.#assetId).reverse();
    this.#rows.show(own);
  }

  #item(replay) {
    const {
      file,
      state,
      records_done: done,
      records_total: total,
      stored,
      repeated,
      refused,
      error,
    } = replay;
    const running = state === "running";
    const pace =
      running && replay.times_real_time ? `, ${number(replay.times_real_time, 2)} times real time` : "";
    const counts = `${count(stored)} stored, ${count(repeated)} already stored, ${count(refused)} refused${pace}`;
    const stop = () => this.#try(() => stopReplay(replay.id));
    return h(
      "li",
      { "data-state": state },
      h(
        "div",
        { class: "plot-head" },
        h("strong", {}, file),
        h("span", {}, state),
        running ? h("button", { type: "button", class: "quiet", onclick: stop }, "Stop") : null,
      ),
      h("progress", {
        max: total ?? 1,
        ...(total !== null || !running ? { value: total === null ? 1 : done } : {}),
        "aria-label": `Replay of ${file}`,
      }),
      h(
        "p",
        { class: "muted" },
        `${count(done)}${total === null ? "" : ` of ${count(total)}`} records: ${counts}${error ? `. ${error}` : ""}`,
      ),
    );
  }
}
