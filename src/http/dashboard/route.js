// The address after `#` holds the whole view, so that a link reproduces it.

/** `{ page: "fleet" | "asset" | "unknown", id, query }` of a hash. */
export function parse(hash) {
  const [path, query = ""] = hash.replace(/^#/, "").split("?", 2);
  const parts = path.split("/").filter(Boolean);
  const parameters = Object.fromEntries(new URLSearchParams(query));
  if (parts.length === 0) return { page: "fleet", query: parameters };
  if (parts.length === 2 && parts[0] === "assets") return { page: "asset", id: decoded(parts[1]), query: parameters };
  return { page: "unknown", query: parameters };
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** The hash of a route; parameters without a value are left out. */
export function format(route) {
  const path = route.page === "asset" ? `#/assets/${encodeURIComponent(route.id)}` : "#/";
  const query = new URLSearchParams(Object.entries(route.query ?? {}).filter(([, value]) => value !== null && value !== undefined && value !== ""));
  return query.size ? `${path}?${query}` : path;
}

/** Changes some parameters of the current route; a step of its own in the browser's history unless `quiet`. */
export function change(parameters, { quiet = false } = {}) {
  const route = parse(location.hash);
  const hash = format({ ...route, query: { ...route.query, ...parameters } });
  if (hash === (location.hash || "#/")) return;
  if (quiet) history.replaceState(null, "", hash);
  else history.pushState(null, "", hash);
  dispatchEvent(new HashChangeEvent("hashchange"));
}
