// Wear over time on the page of an asset.

import { watches } from "./alarm-rule-panel.js";
import { LevelPlot } from "./level-plot.js";
import { lifeOrigin, lifeSpan, lifeSubject } from "./plot-subjects.js";
import { timeOf, wearDrawing, withoutEstimate } from "./wear-plot.js";

/** The plot of the wear estimate with its alarm levels. */
export class WearCard extends LevelPlot {
  /** `shownName` and `redraw` as for a {@link LevelPlot}. */
  constructor(shownName, redraw) {
    super("wear", "Wear over time", { redraw, shownName, names: () => ["wear_um"], prefix: "wear-rule" });
    this.tools.append(this.levelsButton);
  }

  /** Draws the history, or says why there is nothing to draw. */
  async update({ asset, history, latest, events }, query, selected, revision) {
    const failed = history instanceof Error;
    const missing = failed
      ? history.message
      : history.items.length === 0
        ? "This channel has no records yet."
        : withoutEstimate(history.items);
    // Without a pair there is no wear, as the header says
    const isBare = !asset.gear?.pair && !failed && history.items.every((item) => item.median_um == null);
    this.element.hidden = isBare;
    if (isBare) return;
    this.levelsButton.hidden = Boolean(missing);
    const rules = this.showPanel({
      asset,
      channel: history.channel,
      names: missing ? [] : ["wear_um"],
      units: { wear_um: "µm" },
      name: query.levels,
    });
    if (missing) {
      this.showHandles(null);
      this.showNotice(missing);
      return;
    }
    const rule = rules.find((each) => watches(each, "wear_um"));
    const zoomed = timeOf(query.time);
    await this.show(
      () => wearDrawing(history, latest.limits, selected, revision, latest, events, zoomed, rule),
      `${asset.id}-wear-${lifeSpan(history.items)}`,
      () => lifeSubject(asset, history.channel, history.items),
      () => lifeOrigin(asset, history.channel, history.items),
    );
    this.showHandles(0);
  }
}
