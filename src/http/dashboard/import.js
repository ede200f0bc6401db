// The import page: local files, and recordings in the server's replay folder.

import * as api from "./api.js";
import { AssetFrame, refusal } from "./asset-frame.js";
import { h, setChildren } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { ImportDesk } from "./import-desk.js";
import { ReplayPanel } from "./replay-panel.js";

/** Adds records to one asset. */
export class ImportPage {
  holdsEntries = true;
  #id;
  #root;
  #query;
  #frame;
  #desk;
  #replay;

  constructor(root, route) {
    [this.#root, this.#id, this.#query] = [root, route.id, route.query];
    this.#frame = new AssetFrame(route.id, "import");
    this.#frame.update(route.id, route.query);
    [this.#desk, this.#replay] = [new ImportDesk(route.id, { isOnPage: true }), new ReplayPanel(route.id)];
    const card = (panel) => h("div", { class: "card" }, panel.element);
    setChildren(
      root,
      this.#frame.element,
      h("div", { class: "import-grid" }, card(this.#desk), card(this.#replay)),
    );
  }

  /** Reacts to a changed address. */
  update(route) {
    this.#query = route.query;
    this.#desk.changeZone();
    return true;
  }

  /** Fetches the asset's name and the replays; the listed files stay. */
  async refresh(signal) {
    const asset = await api.answer(api.asset(this.#id, signal));
    if (asset instanceof Error) return refusal(this.#root, this.#id, asset);
    this.#frame.update(assetName(asset), this.#query, asset);
    await this.#replay.refresh();
  }

  /** Takes files dropped on the page. */
  takeFiles(files) {
    return this.#desk.take(files);
  }
}
