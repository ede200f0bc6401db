// Picks the page for the address, keeps it live, and shows how fresh it is.

import { AssetPage } from "./asset.js";
import { h, setChildren } from "./dom.js";
import { FleetPage } from "./fleet.js";
import { Live, showStatus } from "./live.js";
import { parse } from "./route.js";
import { bindThemeButton } from "./theme.js";

const byId = (id) => document.getElementById(id);
const main = byId("main");
const view = { live: byId("live"), text: byId("live-text"), banner: byId("banner"), bannerText: byId("banner-text"), bannerWait: byId("banner-wait") };

let page;
let shown = {};
let status = { state: "loading" };

const live = new Live(
  (signal) => page.refresh(signal),
  (changed) => {
    status = changed;
    showStatus(status, view);
  },
);

/** The page of an address that means nothing. */
class UnknownPage {
  constructor(root) {
    document.title = "Not found · flankwatch";
    setChildren(root, h("h1", {}, "No such page"), h("p", { class: "notice" }, "This address leads nowhere. ", h("a", { href: "#/" }, "Go to the fleet")));
  }
  update() {
    return false;
  }
  async refresh() {}
  tick() {}
  dispose() {}
}

const PAGES = { fleet: FleetPage, asset: AssetPage, unknown: UnknownPage };

function follow() {
  const route = parse(location.hash);
  const same = page && route.page === shown.page && route.id === shown.id;
  const first = !page;
  shown = route;
  if (same) {
    if (!page.update(route)) return;
  } else {
    page?.dispose();
    page = new PAGES[route.page](main, route);
    if (!first) {
      main.focus({ preventScroll: true });
      scrollTo(0, 0);
    }
  }
  live.now();
}

bindThemeButton(byId("theme"));
byId("banner-retry").addEventListener("click", () => live.now());
addEventListener("hashchange", follow);
addEventListener("popstate", () => JSON.stringify(parse(location.hash)) !== JSON.stringify(shown) && follow());
document.addEventListener("themechange", () => page.redraw?.());
document.addEventListener("recordschange", () => live.now());
setInterval(() => {
  showStatus(status, view);
  page.tick();
}, 1000);
follow();
