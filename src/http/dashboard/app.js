// Selects the page for the address, keeps it live, and shows the connection status.

import { AlarmCount } from "./alarm-count.js";
import * as api from "./api.js";
import { h, setChildren } from "./dom.js";
import { bindDrops } from "./drop.js";
import { Live, showStatus } from "./live.js";
import { bindLogin, bindLogout } from "./login.js";
import { format, parse } from "./route.js";
import { bindThemeButton } from "./theme.js";
import { bindTimeChoice, routeWithZone } from "./time-zone.js";

const byId = (id) => document.getElementById(id);
const main = byId("main");
const view = {
  live: byId("live"),
  text: byId("live-text"),
  banner: byId("banner"),
  bannerText: byId("banner-text"),
  bannerWait: byId("banner-wait"),
};

let page;
let shown = {};
let built = {}; // the address that the page was built for: its code may have to be loaded first
let status = { state: "loading" };

const alarmCount = new AlarmCount(byId("alarm-count"), byId("alarm-number"));
const live = new Live(
  async (signal) => Promise.all([page?.refresh(signal), alarmCount.refresh(signal)]),
  (changed) => {
    status = changed;
    showStatus(status, view);
  },
);

/** The page for an unknown address. */
class UnknownPage {
  constructor(root) {
    document.title = "Not found · flankwatch";
    setChildren(
      root,
      h("h1", {}, "Page not found"),
      h(
        "p",
        { class: "notice" },
        "There is no page at this address. ",
        h("a", { href: "#/" }, "Go to the fleet"),
      ),
    );
  }
  update() {
    return false;
  }
  async refresh() {}
}

/** Shown while a page's code cannot be loaded, until the server answers again. */
class UnreachedPage {
  #lost = false;
  constructor(root) {
    document.title = "Not loaded · flankwatch";
    const again = h("a", { href: location.href, onclick: () => location.reload() }, "Reload");
    setChildren(root, h("p", { class: "notice" }, "This page could not be loaded from the server. ", again));
  }
  update() {
    return true;
  }
  async refresh(signal) {
    try {
      await api.settle(api.alarms({ limit: 1 }, signal));
    } catch (error) {
      this.#lost ||= error instanceof api.ConnectionError;
      throw error;
    }
    // A browser does not retry a failed module load. If the server was reachable all the time, a reload would
    // not help either.
    if (this.#lost) location.reload();
  }
}

// Page code is loaded on first use, so that the first page does not wait for the others.
const PAGES = {
  fleet: async () => (await import("./fleet.js")).FleetPage,
  asset: async () => (await import("./asset.js")).AssetPage,
  waterfall: async () => (await import("./waterfall.js")).WaterfallPage,
  live: async () => (await import("./stream-page.js")).StreamPage,
  match: async () => (await import("./match.js")).MatchPage,
  wear: async () => (await import("./preview-page.js")).PreviewPage,
  new: async () => (await import("./setup.js")).SetupPage,
  settings: async () => (await import("./settings.js")).SettingsPage,
  records: async () => (await import("./records.js")).RecordsPage,
  import: async () => (await import("./import.js")).ImportPage,
  tokens: async () => (await import("./tokens.js")).TokensPage,
  alarms: async () => (await import("./alarms.js")).AlarmsPage,
  bench: async () => (await import("./bench.js")).BenchPage,
  libraries: async () => (await import("./libraries.js")).LibrariesPage,
  library: async () => (await import("./library.js")).LibraryPage,
  unknown: async () => UnknownPage,
};

/** Marks the current section in the page header. */
function markNavigation(current) {
  const sections = {
    fleet: "fleet",
    new: "fleet",
    alarms: "alarms",
    bench: "bench",
    libraries: "libraries",
    library: "libraries",
    tokens: "tokens",
  };
  const section = sections[current] ?? "";
  /** @type {NodeListOf<HTMLElement>} */
  const links = document.querySelectorAll(".sections a");
  for (const link of links) {
    if (link.dataset.section === section) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
}

/** In another time zone every time on the page is rendered again, unless entries on it would be lost. */
function discardBuilt() {
  if (!page?.holdsEntries) built = {};
}

const isShown = (route) => JSON.stringify(route) === JSON.stringify(shown);

async function showRoute() {
  const { route, isOther } = routeWithZone(byId("times"));
  if (isOther) discardBuilt();
  const same = page && route.page === built.page && route.id === built.id;
  const first = !page;
  // A link changes history and hash: the second event has the route that the first one shows.
  if (
    !same &&
    page?.hasUnsaved &&
    !isShown(route) &&
    !confirm("Leave this page? Its unsaved changes are lost.")
  )
    return history.pushState(null, "", format(shown));
  shown = route;
  markNavigation(route.page);
  if (same) {
    if (!page.update(route)) return;
  } else {
    const Page = await PAGES[route.page]().catch(() => UnreachedPage);
    if (route !== shown) return; // the address has changed in the meantime
    page?.dispose?.();
    page = new Page(main, route);
    built = route;
    if (!first) {
      main.focus({ preventScroll: true });
      scrollTo(0, 0);
    }
  }
  live.now();
}

bindDrops(() => ({ page, id: shown.page === "library" ? undefined : shown.id }));
bindThemeButton(byId("theme"));
bindTimeChoice(byId("times"), async () => {
  discardBuilt();
  await showRoute();
  byId("times").focus();
});
const lookForSession = bindLogout(byId("logout"), byId("tokens-link"));
bindLogin(() => {
  lookForSession();
  live.now();
});
byId("banner-retry").addEventListener("click", () => live.now());
addEventListener("hashchange", showRoute);
addEventListener("beforeunload", (event) => page?.hasUnsaved && event.preventDefault());
addEventListener("popstate", () => isShown(parse(location.hash)) || showRoute());
document.addEventListener("themechange", () => page?.redraw?.());
document.addEventListener("sessionchange", lookForSession);
document.addEventListener("recordschange", () => live.now());
setInterval(() => {
  showStatus(status, view);
  page?.tick?.();
}, 1000);
showRoute();
lookForSession();
