// The address after `#` holds the whole view, so that a link reproduces it.

const ASSET_VIEWS = ["records", "import", "live", "waterfall", "match", "wear", "settings"];

/**
 * Parses a hash into `{ page, id, query }`; `page` is "fleet", "asset" or one of its views, "new", "alarms",
 * "bench", "tokens", "libraries", "library" or "unknown".
 */
export function parse(hash) {
  const [path, query = ""] = hash.replace(/^#/, "").split("?", 2);
  const [first, second, third, ...more] = path.split("/").filter(Boolean);
  const id = second === undefined ? undefined : decoded(second);
  return { ...place(first, id, third, more), query: Object.fromEntries(new URLSearchParams(query)) };
}

function place(first, id, third, more) {
  if (first === undefined) return { page: "fleet" };
  if (more.length === 0 && first === "assets" && id !== undefined) {
    if (third === undefined) return { page: "asset", id };
    if (ASSET_VIEWS.includes(third)) return { page: third, id };
  }
  if (id === undefined && ["alarms", "bench", "new", "tokens"].includes(first)) return { page: first };
  if (third === undefined && first === "libraries")
    return id === undefined ? { page: "libraries" } : { page: "library", id };
  return { page: "unknown" };
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function path({ page, id }) {
  const name = encodeURIComponent(id ?? "");
  if (page === "asset") return `#/assets/${name}`;
  if (ASSET_VIEWS.includes(page)) return `#/assets/${name}/${page}`;
  if (page === "library") return `#/libraries/${name}`;
  return (
    { libraries: "#/libraries", alarms: "#/alarms", bench: "#/bench", new: "#/new", tokens: "#/tokens" }[
      page
    ] ?? "#/"
  );
}

/** Formats a route as a hash; parameters without a value are omitted. */
export function format(route) {
  const query = new URLSearchParams(
    Object.entries(route.query ?? {}).filter(
      ([, value]) => value !== null && value !== undefined && value !== "",
    ),
  );
  return query.size ? `${path(route)}?${query}` : path(route);
}

/** Goes to another page. */
export function go(route) {
  location.hash = format(route);
}

/** Changes parameters of the current route; adds a history entry unless `quiet`. */
export function change(parameters, { quiet = false } = {}) {
  const route = parse(location.hash);
  const hash = format({ ...route, query: { ...route.query, ...parameters } });
  if (hash === (location.hash || "#/")) return;
  if (quiet) history.replaceState(null, "", hash);
  else history.pushState(null, "", hash);
  dispatchEvent(new HashChangeEvent("hashchange"));
}
