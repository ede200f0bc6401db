// Model preview of the wear of an asset's gear pair.

import { FramedPage } from "./asset-frame.js";
import { h, setChildren } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { PreviewPanel } from "./preview-panel.js";

/** The page where an asset's wear is previewed. */
export class PreviewPage extends FramedPage {
  #asset;
  #panel = new PreviewPanel();

  constructor(root, route) {
    super(root, route, "wear");
    setChildren(
      root,
      this.head.element,
      h(
        "p",
        { class: "muted" },
        "Model prediction for this gear pair at any wear depth, torque and speed, without measurements.",
      ),
      this.#panel.element,
    );
  }

  update(route) {
    this.query = route.query;
    return false;
  }

  /** Fetches the asset and previews it when its pair has changed. */
  async refresh(signal) {
    const asset = await this.loadAsset(signal);
    if (!asset) return;
    const same = this.#asset && JSON.stringify(asset.gear) === JSON.stringify(this.#asset.gear);
    this.#asset = asset;
    if (same) return;
    if (asset.gear?.pair) this.#panel.describe(asset.gear, 0, assetName(asset));
    else
      this.#panel.lacking(
        asset.gear
          ? "This asset has no gear pair. Add one in its settings to preview its wear."
          : "This machine has no gear mesh, so there is no wear to preview.",
      );
  }

  /** Redraws in a changed theme. */
  redraw() {
    return this.#panel.redraw();
  }

  dispose() {
    this.#panel.dispose();
  }
}
