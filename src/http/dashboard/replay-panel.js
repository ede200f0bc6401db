// Replays of recordings in the server's folder: start, progress, stop.

import { ApiError, replayFiles, replays, startReplay, stopReplay } from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { bytes, count, number } from "./format.js";

const PACES = [
  ["max", "as fast as possible"],
  ["10x", "ten times real time"],
  ["realtime", "real time"],
];

/** The replay section of the dialog. */
export class ReplayPanel {
  #assetId;
  #file = h("input", {
    id: "replay-file",
    required: true,
    placeholder: "run.mcap",
    autocomplete: "off",
    list: "replay-files",
  });
  #files = h("datalist", { id: "replay-files" });
  #empty = h("p", { class: "muted", hidden: true }, "The replay folder contains no recordings.");
  #pace = h(
    "select",
    { id: "replay-pace" },
    PACES.map(([value, label]) => h("option", { value }, label)),
  );
  #error = h("p", { class: "result", "data-kind": "bad", role: "status", hidden: true });
  #list = h("ul", { class: "replays" });
  #shown;
  element;

  constructor(assetId) {
    this.#assetId = assetId;
    const form = h(
      "form",
      { class: "fields", onsubmit: (event) => this.#start(event) },
      h(
        "label",
        { class: "field", for: "replay-file" },
        h("span", {}, "File in the replay folder"),
        this.#file,
        this.#files,
      ),
      h("label", { class: "field", for: "replay-pace" }, h("span", {}, "Pace"), this.#pace),
      h("button", { type: "submit" }, "Start replay"),
    );
    this.element = h(
      "section",
      {},
      h("h3", {}, "Replay a recording on the server"),
      form,
      this.#empty,
      this.#error,
      this.#list,
    );
    this.#listFiles();
  }

  /** The available files; without an answer, a name can still be entered. */
  async #listFiles() {
    const answer = await replayFiles().catch(() => null);
    if (!answer) return;
    this.#empty.hidden = answer.items.length > 0;
    setChildren(
      this.#files,
      answer.items.map(({ file, bytes: size }) => h("option", { value: file }, `${file}, ${bytes(size)}`)),
    );
  }

  async #start(event) {
    event.preventDefault();
    await this.#try(() =>
      startReplay({ asset: this.#assetId, file: this.#file.value.trim(), pace: this.#pace.value }),
    );
  }

  async #try(action) {
    this.#error.hidden = true;
    try {
      await action();
      await this.refresh();
    } catch (error) {
      this.#error.hidden = false;
      setText(this.#error, error.message);
    }
  }

  /** Fetches this asset's replays. The page reports a lost connection. */
  async refresh() {
    let answer;
    try {
      answer = await replays();
    } catch (error) {
      if (error instanceof ApiError) setText(this.#error, error.message);
      return;
    }
    if (answer === this.#shown) return;
    this.#shown = answer;
    const own = answer.items.filter((replay) => replay.asset === this.#assetId).reverse();
    setChildren(
      this.#list,
      own.map((replay) => this.#item(replay)),
    );
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
