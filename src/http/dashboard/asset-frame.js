// The asset pages and their common head: breadcrumb, name, and links to the asset's other pages.

import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { format } from "./route.js";

/** @type {[string, string][]} */
const VIEWS = [
  ["asset", "Overview"],
  ["records", "Records"],
  ["import", "Import"],
  ["live", "Live"],
  ["waterfall", "Waterfall"],
  ["match", "Match"],
  ["wear", "Wear preview"],
  ["settings", "Settings"],
];
const KEPT = ["channel", "segment"]; // query parameters kept when switching pages

export const INVALID = "Not saved. Check the highlighted field.";

/** Why a description was not saved, and what to do when it has changed since the page was opened. */
export const savingWords = (error) =>
  error.status === 412
    ? "Saving failed: the asset has been changed since this page was opened, in another window or by somebody else. Reload the page, which discards your changes, and enter them again."
    : `Saving failed: ${error.message}.`;

const LOOK_MS = 10_000;
const lookups = new Map(); // asset → when its live streams were last fetched, and the response
const streaming = new Set(); // assets known to have live streams

/** Whether an asset has live streams; the last known response when the server does not respond. */
async function fetchHasStreams(id) {
  try {
    const response = await api.settle(api.streams(id));
    if (response instanceof Error || response.items.length === 0) streaming.delete(id);
    else streaming.add(id);
  } catch {
    // The page itself reports the lost connection
  }
  return streaming.has(id);
}

function hasStreams(id) {
  const known = lookups.get(id);
  if (known && Date.now() - known.at < LOOK_MS) return known.response;
  const response = fetchHasStreams(id);
  lookups.set(id, { at: Date.now(), response });
  return response;
}

/**
 * Links between the pages of an asset; the live page is linked only when there are live streams. The links stay
 * the same elements, so that an update does not take the focus from them.
 */
export class AssetTabs {
  #id;
  #current;
  #links;
  element;

  constructor(id, current) {
    [this.#id, this.#current] = [id, current];
    this.#links = VIEWS.map(([page, label]) => ({
      page,
      link: h("a", { "aria-current": page === current ? "page" : null }, label),
    }));
    const report = h(
      "a",
      {
        href: new URL(`v1/assets/${encodeURIComponent(id)}/report`, document.baseURI).href,
        target: "_blank",
        rel: "noopener",
      },
      "Report",
    );
    this.element = h(
      "nav",
      { class: "tabs", "aria-label": "Pages of this asset" },
      this.#links.map(({ link }) => link),
      report,
    );
  }

  /** The links keep the selection in the address; a machine without gears has no wear to preview. */
  update(query, asset) {
    const kept = Object.fromEntries(KEPT.filter((name) => query[name]).map((name) => [name, query[name]]));
    for (const { page, link } of this.#links)
      link.setAttribute("href", format({ page, id: this.#id, query: kept }));
    const { link: wear } = this.#links.find(({ page }) => page === "wear");
    wear.hidden = Boolean(asset) && !asset.gear && this.#current !== "wear";
    const { link: live } = this.#links.find(({ page }) => page === "live");
    live.hidden = this.#current !== "live" && !streaming.has(this.#id);
    if (live.hidden) hasStreams(this.#id).then((has) => (live.hidden = !has));
  }
}

/** The breadcrumb. */
export function crumbs(...links) {
  return h(
    "nav",
    { class: "crumbs", "aria-label": "Breadcrumb" },
    links.flatMap(([href, text], place) => [
      place ? h("span", { "aria-hidden": "true" }, "›") : null,
      h("a", { href }, text),
    ]),
  );
}

/** The head of an asset page; call `update` when the asset or the address changes. */
export class AssetFrame {
  #page;
  #title = h("h1");
  #crumbs;
  #tabs;
  element;

  constructor(id, page) {
    this.#page = page;
    this.#tabs = new AssetTabs(id, page);
    this.#title.textContent = id;
    this.#crumbs = crumbs(["#/", "Fleet"], [format({ page: "asset", id }), id]);
    this.element = h("header", { class: "asset-header" }, this.#crumbs, this.#title, this.#tabs.element);
  }

  /** Shows the asset's name and the links, which keep the selection; `asset` is known later than its id. */
  update(name, query, asset) {
    const label = VIEWS.find(([page]) => page === this.#page)[1];
    setText(this.#title, name);
    setText(this.#crumbs.querySelector("a:last-child"), name);
    document.title = `${label} · ${name} · flankwatch`;
    this.#tabs.update(query, asset);
  }
}

/** The page for an asset that does not exist or cannot be shown. */
export function refusal(root, id, error) {
  const words = error.status === 404 ? `Asset “${id}” not found on this server.` : error.message;
  document.title = "Not found · flankwatch";
  setChildren(
    root,
    h("h1", {}, id),
    h("p", { class: "notice" }, `${words} `, h("a", { href: "#/" }, "Go to the fleet")),
  );
}

/** The page of an asset when the channel in the address has no records. */
export function unknownChannel(root, asset, query, page) {
  const { channel, segment, ...others } = query;
  const frame = new AssetFrame(asset.id, page);
  frame.update(assetName(asset), others, asset);
  const link = (name) =>
    h("a", { href: format({ page, id: asset.id, query: { ...others, channel: name } }) }, name);
  const { channels } = asset.summary;
  setChildren(
    root,
    frame.element,
    h(
      "p",
      { class: "notice" },
      `Channel “${channel}” has no records. `,
      channels.length ? "Channels with records: " : "The asset has none yet.",
      channels.flatMap((name, n) => [n ? ", " : "", link(name)]),
    ),
  );
}

/** A page of one asset, under the common head. */
export class FramedPage {
  constructor(root, route, page) {
    this.root = root;
    this.id = route.id;
    this.query = route.query;
    this.head = new AssetFrame(route.id, page);
    this.head.update(route.id, route.query);
  }

  /** Reacts to a changed address; returns whether to fetch again. */
  update(route) {
    this.query = route.query;
    return true;
  }

  /** Fetches the asset for the head; says why, and returns nothing, if it cannot be shown. */
  async loadAsset(signal) {
    const asset = await api.settle(api.asset(this.id, signal));
    if (asset instanceof Error) return void refusal(this.root, this.id, asset);
    this.head.update(assetName(asset), this.query, asset);
    return asset;
  }
}
