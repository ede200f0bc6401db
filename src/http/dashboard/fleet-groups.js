// The fleet by place: site, machine and gearbox of each asset, or what stands before the last slash of a name such as “North plant / line 3 / mesh”.

import { h, setChildren, setText } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { change } from "./route.js";
import { assetState, rank, STATES } from "./state.js";
import { symbol } from "./symbols.js";

/** Where an asset is, empty where that is not known. */
export function placeOf(asset) {
  const { site, machine, gearbox } = asset.location ?? {};
  const place = [site, machine, gearbox].filter(Boolean).join(" / ");
  if (place) return place;
  return assetName(asset).split("/").slice(0, -1).map((part) => part.trim()).filter(Boolean).join(" / ");
}

function toggle(place, closed) {
  const rest = closed.includes(place) ? closed.filter((other) => other !== place) : [...closed, place];
  change({ closed: rest.map(encodeURIComponent).join(",") || null });
}

function header(groups, place, columns) {
  if (groups.has(place)) return groups.get(place);
  const icon = h("span", { "aria-hidden": "true" });
  const sign = h("span");
  const words = h("span", { class: "muted" });
  const button = h("button", { type: "button" }, icon, sign, place || "Without a place", words);
  const element = h("tr", { class: "group" }, h("th", { scope: "colgroup", colspan: columns }, button));
  const group = { element, button, icon, sign, words };
  groups.set(place, group);
  return group;
}

/** Rows of assets under a heading each for their places; `groups` keeps headings, `closedText` is the address's list of closed ones. */
export function groupRows(assets, rowOf, groups, columns, closedText) {
  const closed = (closedText ?? "").split(",").filter(Boolean).map(decodeURIComponent);
  const places = new Map();
  for (const asset of assets) places.set(placeOf(asset), [...(places.get(placeOf(asset)) ?? []), asset]);
  return [...places].sort(([a], [b]) => Number(!a) - Number(!b) || a.localeCompare(b, "en", { numeric: true })).flatMap(([place, members]) => {
    const group = header(groups, place, columns);
    const open = !closed.includes(place);
    const worst = members.map(assetState).sort((a, b) => rank(a) - rank(b))[0];
    setText(group.icon, open ? "▾" : "▸");
    setChildren(group.sign, symbol(worst, 18));
    setText(group.words, `${members.length} ${members.length === 1 ? "asset" : "assets"}, worst: ${STATES[worst].short}`);
    group.button.setAttribute("aria-expanded", String(open));
    group.button.onclick = () => toggle(place, closed);
    return open ? [group.element, ...members.map(rowOf)] : [group.element];
  });
}
