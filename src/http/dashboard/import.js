// The import page: local files, and recordings in the server's replay folder.

import { FramedPage } from "./asset-frame.js";
import { h, setChildren } from "./dom.js";
import { ImportDesk } from "./import-desk.js";
import { ReplayPanel } from "./replay-panel.js";

/** Adds records to one asset. */
export class ImportPage extends FramedPage {
  holdsEntries = true;
  #desk = new ImportDesk(this.id, { isOnPage: true });
  #replay = new ReplayPanel(this.id);

  constructor(root, route) {
    super(root, route, "import");
    const card = (panel) => h("div", { class: "card" }, panel.element);
    setChildren(
      root,
      this.head.element,
      h("div", { class: "import-grid" }, card(this.#desk), card(this.#replay)),
    );
  }

  /** Reacts to a changed address. */
  update(route) {
    this.query = route.query;
    this.#desk.changeZone();
    return true;
  }

  /** Fetches the asset's name and the replays; the listed files stay. */
  async refresh(signal) {
    if (await this.loadAsset(signal)) await this.#replay.refresh();
  }

  /** Takes files dropped on the page. */
  takeFiles(files) {
    return this.#desk.take(files);
  }
}
