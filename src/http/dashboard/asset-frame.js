// What every page of an asset begins with: where one is, the asset's name, and the ways to its other pages.

import * as api from "./api.js";
import { h, setChildren } from "./dom.js";
import { format } from "./route.js";

const VIEWS = [
  ["asset", "Overview"],
  ["records", "Records"],
  ["import", "Import"],
  ["live", "Live"],
  ["waterfall", "Waterfall"],
  ["match", "Match"],
  ["wear", "What wear does"],
  ["settings", "Settings"],
];
const KEPT = ["channel", "segment"]; // what is looked at goes along

const LOOK_MS = 10_000;
const looks = new Map(); // asset → when its live streams were asked for, and the answer
const streaming = new Set(); // assets that are known to have some

/** Whether an asset has live streams; what was known where the server does not say. */
async function lookForStreams(id) {
  try {
    const answer = await api.answer(api.streams(id));
    if (answer instanceof Error || answer.items.length === 0) streaming.delete(id);
    else streaming.add(id);
  } catch {
    // the page itself says that the connection is lost
  }
  return streaming.has(id);
}

function hasStreams(id) {
  const known = looks.get(id);
  if (known && Date.now() - known.at < LOOK_MS) return known.answer;
  const answer = lookForStreams(id);
  looks.set(id, { at: Date.now(), answer });
  return answer;
}

/** Links between the pages of an asset; that of its live streams only where it has some. */
export function assetTabs(id, current, query = {}) {
  const kept = Object.fromEntries(KEPT.filter((name) => query[name]).map((name) => [name, query[name]]));
  const link = ([page, label]) =>
    h(
      "a",
      { href: format({ page, id, query: kept }), "aria-current": page === current ? "page" : null },
      label,
    );
  const report = h(
    "a",
    {
      href: new URL(`v1/assets/${encodeURIComponent(id)}/report`, document.baseURI).href,
      target: "_blank",
      rel: "noopener",
    },
    "Report",
  );
  const links = VIEWS.map(link);
  const live = links[VIEWS.findIndex(([page]) => page === "live")];
  live.hidden = current !== "live" && !streaming.has(id);
  if (live.hidden) hasStreams(id).then((has) => (live.hidden = !has));
  return h("nav", { class: "tabs", "aria-label": "Pages of this asset" }, links, report);
}

/** The way back. */
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

/** The head of a page that shows one side of an asset; `update` when the asset or the address changes. */
export class AssetFrame {
  #id;
  #page;
  #title = h("h1");
  #tabs = h("div");
  element;

  constructor(id, page) {
    this.#id = id;
    this.#page = page;
    this.#title.textContent = id;
    this.element = h(
      "header",
      { class: "asset-header" },
      crumbs(["#/", "Fleet"], [format({ page: "asset", id }), id]),
      this.#title,
      this.#tabs,
    );
  }

  /** Shows the asset's name and links that keep what is looked at. */
  update(name, query) {
    const label = VIEWS.find(([page]) => page === this.#page)[1];
    this.#title.textContent = name;
    document.title = `${label} · ${name} · flankwatch`;
    setChildren(this.#tabs, assetTabs(this.#id, this.#page, query));
  }
}

/** The page of an asset that there is not, or that cannot be shown. */
export function refusal(root, id, error) {
  const words = error.status === 404 ? `There is no asset “${id}” on this server.` : error.message;
  document.title = "Not found · flankwatch";
  setChildren(
    root,
    h("h1", {}, id),
    h("p", { class: "notice" }, `${words} `, h("a", { href: "#/" }, "Go to the fleet")),
  );
}
