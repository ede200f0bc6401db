// Groups the fleet by place: site, machine and gearbox of each asset, or the part before the last “ / ” of a
// name such as “North plant / line 3 / mesh”.

import { h, setChildren, setText } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { change } from "./route.js";
import { assetState, rank, STATES } from "./state.js";
import { symbol } from "./symbols.js";

const NOWHERE = "/"; // the unknown place in an address; an encoded name has no slash

/** The place of an asset; empty when unknown. */
export function placeOf(asset) {
  const { site, machine, gearbox } = asset.location ?? {};
  const place = [site, machine, gearbox].filter(Boolean).join(" / ");
  if (place) return place;
  return assetName(asset)
    .split(" / ")
    .slice(0, -1)
    .map((part) => part.trim())
    .filter(Boolean)
    .join(" / ");
}

/**
 * `{ place, members, open, closed }` per place, each followed by its assets when open; `closedText` is the
 * list of closed places in the address.
 */
export function grouped(assets, closedText) {
  const closed = (closedText ?? "")
    .split(",")
    .filter(Boolean)
    .map((text) => (text === NOWHERE ? "" : decodeURIComponent(text)));
  const places = Map.groupBy(assets, placeOf);
  // In the order of their first assets, so that sorting by state puts the worst places on top
  return [...places].flatMap(([place, members]) => {
    const group = { place, members, open: !closed.includes(place), closed };
    return group.open ? [group, ...members] : [group];
  });
}

/** The heading row of one place. */
export class GroupRow {
  #group;
  #icon = h("span", { "aria-hidden": "true" });
  #sign = h("span");
  #name = h("span");
  #words = h("span", { class: "muted" });
  #button = h(
    "button",
    { type: "button", onclick: () => this.#toggle() },
    this.#icon,
    this.#sign,
    this.#name,
    this.#words,
  );
  element;

  constructor(columns) {
    this.element = h(
      "tr",
      { class: "group", role: "row" },
      h("th", { scope: "colgroup", role: "rowheader", colspan: columns }, this.#button),
    );
  }

  #toggle() {
    const { place, closed } = this.#group;
    const rest = closed.includes(place) ? closed.filter((other) => other !== place) : [...closed, place];
    change({ closed: rest.map((name) => encodeURIComponent(name) || NOWHERE).join(",") || null });
  }

  /** Shows a group of `grouped`. */
  update(group) {
    this.#group = group;
    const { place, members, open } = group;
    const worst = members.map(assetState).sort((a, b) => rank(a) - rank(b))[0];
    setText(this.#icon, open ? "▾" : "▸");
    setChildren(this.#sign, symbol(worst, 18));
    setText(this.#name, place || "No location");
    setText(
      this.#words,
      `${members.length} ${members.length === 1 ? "asset" : "assets"}, worst: ${STATES[worst].short}`,
    );
    this.#button.setAttribute("aria-expanded", String(open));
  }
}
