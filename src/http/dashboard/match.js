// Evidence for a record's wear depth: its features compared with the library, the posterior, the flanks, and
// the mesh of the best state.

import * as api from "./api.js";
import { FramedPage } from "./asset-frame.js";
import { h, setChildren } from "./dom.js";
import { FlankCard } from "./flank-drawing.js";
import { featureDrawing } from "./feature-plot.js";
import { matchWords } from "./match-words.js";
import { stiffnessDrawing, transmissionDrawing } from "./mesh-plots.js";
import { noveltyDrawing } from "./novelty-plot.js";
import { recordSubject } from "./plot-subjects.js";
import { PlotCard } from "./plot-card.js";
import { clock } from "./format.js";
import { sentence } from "./state.js";
import { posteriorDrawing } from "./posterior-plot.js";

const MATCHED = ["estimated", "not_identifiable"]; // records with these statuses may have a best state

/** The match of the selected or latest record with the library. */
export class MatchPage extends FramedPage {
  #data;
  #words = h("section", { class: "card match-words" });
  #features = new PlotCard("features", "Change since the baseline: measured and expected");
  #posterior = new PlotCard("posterior", "Posterior over wear depth");
  #flank = new FlankCard();
  #stiffness = new PlotCard("stiffness", "Mesh stiffness");
  #transmission = new PlotCard("transmission", "Unloaded transmission error");
  #novelty = new PlotCard("novelty", "Largest deviations not explained by wear");
  #notice = h("p", { class: "notice loading" }, "Loading…");
  #grid;

  constructor(root, route) {
    super(root, route, "match");
    const left = h("div", { class: "column" }, this.#words, this.#features.element, this.#posterior.element);
    const right = h(
      "div",
      { class: "column" },
      this.#flank.element,
      this.#stiffness.element,
      this.#transmission.element,
    );
    this.#grid = h("div", { class: "asset-grid", hidden: true }, left, right);
    this.#novelty.element.hidden = true;
    setChildren(root, this.head.element, this.#notice, this.#novelty.element, this.#grid);
  }

  /** Fetches the match and shows what changed. */
  async refresh(signal) {
    const asset = await this.loadAsset(signal);
    if (!asset) return;
    const latest = await api.settle(api.wear(this.id, this.query.channel, signal));
    if (latest instanceof Error) return this.#showNotice(latest.message);
    const id = this.query.segment ?? latest.segment_id;
    if (!id) return this.#showNotice("No records yet.");
    const segment = await api.settle(api.segment(id, signal));
    if (segment instanceof Error) return this.#showNotice(segment.message);
    if (!MATCHED.includes(segment.wear.status) || !segment.wear.best_state)
      return this.#unmatched(segment, asset);
    const match = await api.settle(api.match(id, signal));
    if (match instanceof Error) return this.#showNotice(match.message);
    if (match === this.#data?.match && asset.updated_at === this.#data.asset?.updated_at) return;
    const { library_id: library, state_index: index, wear_um: depth } = match;
    const [state, unworn, flank] = await Promise.all([
      api.settle(api.libraryState(library, index, signal)),
      api.settle(api.libraryState(library, 0, signal)),
      api.settle(api.flank(library, Math.round(depth), signal)),
    ]);
    this.#data = { asset, segment, match, state, unworn, flank };
    await this.redraw();
  }

  #showNotice(words) {
    this.#notice.textContent = words;
    this.#notice.hidden = false;
    this.#grid.hidden = this.#novelty.element.hidden = true;
    this.#data = undefined; // the match is drawn again when it is back
  }

  /** A record without a best state, with its largest deviations if known. */
  async #unmatched(segment, asset) {
    const hasPair = Boolean(asset.gear?.pair);
    this.#showNotice(
      `Record of ${clock(segment.start_time)}: ${sentence(segment.wear, undefined, hasPair, Boolean(asset.gear))}`,
    );
    const { novelty } = segment.wear;
    this.#novelty.element.hidden = !novelty?.largest_deviations?.length;
    this.#data = { unmatched: segment, asset };
    if (novelty?.largest_deviations?.length)
      await this.#novelty.show(
        () => noveltyDrawing(novelty, this.id, hasPair),
        `${this.id}-novelty-${segment.start_time}`,
        () => recordSubject(segment, asset),
      );
  }

  /** Redraws from known data. */
  async redraw() {
    if (!this.#data) return;
    if (this.#data.unmatched) return this.#unmatched(this.#data.unmatched, this.#data.asset);
    this.#novelty.element.hidden = true;
    const { asset, segment, match, state, unworn, flank } = this.#data;
    this.#notice.hidden = true;
    this.#grid.hidden = false;
    const name = `${this.id}-match-${segment.start_time}`;
    setChildren(this.#words, matchWords(segment, match, asset, this.query));
    this.#flank.show(flank, match);
    const subject = () => recordSubject(segment, asset);
    const mesh = state instanceof Error ? state : unworn;
    await Promise.all([
      this.#features.show(() => featureDrawing(match, this.id), `${name}-features`, subject),
      this.#posterior.show(
        () => posteriorDrawing(segment.wear, asset.limits, segment.reference_wear_um, this.id),
        `${name}-posterior`,
        subject,
      ),
      this.#stiffness.show(
        () => mesh.message ?? stiffnessDrawing(state, unworn, this.id),
        `${name}-stiffness`,
        subject,
      ),
      this.#transmission.show(
        () => mesh.message ?? transmissionDrawing(state, unworn, asset.gear.pair.geometry, this.id),
        `${name}-transmission-error`,
        subject,
      ),
    ]);
  }

  /** Releases the plots. */
  dispose() {
    for (const card of [this.#novelty, this.#features, this.#posterior, this.#stiffness, this.#transmission])
      card.dispose();
  }
}
