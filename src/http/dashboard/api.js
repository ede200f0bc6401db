// The only module that talks to the server. An unchanged response is returned as the same object, so callers
// detect changes by identity.

const MAX_CACHED = 48;
const MAX_CACHED_CHARACTERS = 40e6; // a spectrum at full resolution has some millions
const cache = new Map(); // address → { text, data }, most recently used last
const tags = new WeakMap(); // response → its entity tag
let logins = 0;

/** An error answered by the server; `problem` is its RFC 9457 body, if any. */
export class ApiError extends Error {
  constructor(status, problem) {
    super(problem.detail || problem.title || `the server answered ${status}`);
    this.status = status;
    this.problem = problem;
  }
}

/** No response, or a response saying that the service is unavailable. */
export class ConnectionError extends Error {}

/**
 * Starts a session with a token. The server sets a cookie that scripts cannot read and that every request and
 * link sends.
 */
export async function logIn(token) {
  const { response, text } = await request(address(["session"]), {
    method: "POST",
    headers: { authorization: `Bearer ${token.trim()}` },
  });
  if (!response.ok) throw failure(response.status, text);
  cache.clear();
  logins += 1;
}

/** Ends the session. */
export const logOut = () => send("DELETE", ["session"]);

/** The session's token without its secret; null when no token is required. */
export const session = async () => (await get(["session"], {})).token;

/** An address under /v1, relative to the page so that a proxy's path prefix is kept. */
export function address(segments, parameters = {}) {
  const url = new URL(["v1", ...segments.map(encodeURIComponent)].join("/"), document.baseURI);
  url.hash = "";
  for (const [name, value] of Object.entries(parameters)) {
    if (value !== null && value !== undefined && value !== "") url.searchParams.set(name, value);
  }
  return url.href;
}

function cacheResponse(href, entry) {
  cache.delete(href);
  cache.set(href, entry);
  let characters = [...cache.values()].reduce((sum, { text }) => sum + text.length, 0);
  for (const [oldest, { text }] of cache) {
    if (cache.size <= MAX_CACHED && characters <= MAX_CACHED_CHARACTERS) break;
    cache.delete(oldest);
    characters -= text.length;
  }
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

/** The error for a response outside 2xx. */
export function failure(status, text) {
  const problem = parsed(text) ?? {};
  const gone = status === 502 || status === 503 || status === 504;
  return gone
    ? new ConnectionError(problem.detail ?? `the server answered ${status}`)
    : new ApiError(status, problem);
}

async function request(href, options) {
  const before = logins;
  try {
    const response = await fetch(href, options);
    // A request sent before the login may be answered after it.
    if (response.status === 401 && before === logins) document.dispatchEvent(new CustomEvent("tokenneeded"));
    return { response, text: await response.text() };
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new ConnectionError("no answer from the server", { cause: error });
  }
}

async function get(segments, parameters, signal) {
  const href = address(segments, parameters);
  const known = cache.get(href);
  const headers = { accept: "application/json" };
  const etag = known && tags.get(known.data);
  if (etag) headers["if-none-match"] = etag;
  const { response, text } = await request(href, { headers, signal, cache: "no-store" });
  if (known && (response.status === 304 || (response.ok && text === known.text))) {
    cacheResponse(href, known);
    return known.data;
  }
  if (!response.ok) throw failure(response.status, text);
  const data = parsed(text);
  if (data === null) throw new ApiError(response.status, { title: "the server's answer is not JSON" });
  keepTag(data, response);
  cacheResponse(href, { text, data });
  return data;
}

function keepTag(data, response) {
  if (data instanceof Object) tags.set(data, response.headers.get("etag"));
}

const JSON_TYPE = "application/json";

/**
 * Sends a body, as JSON unless it has another `type`; `known` is the response that must still be valid.
 * @param {{ signal?: AbortSignal, parameters?: object, type?: string, known?: object }} [options]
 */
async function send(method, segments, body, options = {}) {
  const { signal, parameters, type = JSON_TYPE, known } = options;
  const etag = known && tags.get(known);
  const headers = {
    accept: JSON_TYPE,
    ...(body && { "content-type": type }),
    ...(etag && { "if-match": etag }),
  };
  const { response, text } = await request(address(segments, parameters), {
    method,
    headers,
    signal,
    body: body && type === JSON_TYPE ? JSON.stringify(body) : body,
  });
  if (!response.ok) throw failure(response.status, text);
  const data = parsed(text);
  keepTag(data, response);
  return data;
}

/**
 * Fetches every asset, page by page.
 * @returns {Promise<Answer<"/v1/assets">["items"]>}
 */
export async function assets(signal) {
  const pages = [];
  let cursor;
  do {
    const page = await get(["assets"], { limit: 1000, cursor }, signal);
    pages.push(page.items);
    cursor = page.next_cursor;
  } while (cursor);
  return pages.length === 1 ? pages[0] : pages.flat();
}

/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}">>} */
export const asset = (id, signal) => get(["assets", id], {}, signal);
/** @type {(id: string, channel?: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/wear">>} */
export const wear = (id, channel, signal) => get(["assets", id, "wear"], { channel }, signal);
/** @type {(id: string, channel?: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/wear/hindsight">>} */
export const wearHindsight = (id, channel, signal) =>
  get(["assets", id, "wear", "hindsight"], { channel }, signal);
/** @typedef {{ from: string, to: string }} TimeRange */
/** @type {(range?: TimeRange) => object} */
const historyPart = (range) => (range ? { ...range, max_points: 5000 } : { max_points: 2000 });
/** @type {(id: string, channel?: string, signal?: AbortSignal, range?: TimeRange) => Promise<Answer<"/v1/assets/{asset}/wear/history">>} */
export const wearHistory = (id, channel, signal, range) =>
  get(["assets", id, "wear", "history"], { channel, ...historyPart(range) }, signal);
/** @type {(id: string, channel: string | undefined, names: string[], signal?: AbortSignal, range?: TimeRange) => Promise<Answer<"/v1/assets/{asset}/indicators">>} */
export const indicators = (id, channel, names, signal, range) =>
  get(["assets", id, "indicators"], { channel, names: names.join(","), ...historyPart(range) }, signal);
/** @type {(id: string, channel: string, name: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/indicators">>} */
export const indicatorUnits = (id, channel, name, signal) =>
  get(["assets", id, "indicators"], { channel, names: name, max_points: 10 }, signal);
/** @type {(id: string, channel?: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/segments">>} */
export const segments = (id, channel, signal) =>
  get(["assets", id, "segments"], { channel, limit: 1000, order: "desc" }, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}">>} */
export const segment = (id, signal) => get(["segments", id], {}, signal);
/** @type {(id: string, from?: number, to?: number, signal?: AbortSignal, motion?: object) => Promise<Answer<"/v1/segments/{segment}/waveform">>} */
export const waveform = (id, from, to, signal, motion = {}) =>
  get(["segments", id, "waveform"], { max_points: 4000, from_s: from, to_s: to, ...motion }, signal);
/** @type {(id: string, from?: number, to?: number, points?: number, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/orders">>} */
export const orders = (id, from, to, points, signal) =>
  get(["segments", id, "orders"], { from_order: from, to_order: to, max_points: points }, signal);
/** @type {(id: string, at: number[], axis: "hz" | "orders", band?: number[], signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/lines">>} */
export const lines = (id, at, axis, band, signal) => {
  const envelope = band && { spectrum: "envelope", band_low_hz: band[0], band_high_hz: band[1] };
  return get(["segments", id, "lines"], { at: at.join(","), axis, ...envelope }, signal);
};
/** @type {(id: string, gear: 1 | 2, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/turn">>} */
export const turn = (id, gear, signal) =>
  get(["segments", id, "turn"], { gear: gear === 2 ? gear : null }, signal);
/** @type {(id: string, end?: number, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/cepstrum">>} */
export const cepstrum = (id, end, signal) =>
  get(["segments", id, "cepstrum"], { max_points: 4000, max_s: end }, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/match">>} */
export const match = (id, signal) => get(["segments", id, "match"], {}, signal);
/** @type {(id: string, parameters: object, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/waterfall">>} */
export const waterfall = (id, parameters, signal) => get(["assets", id, "waterfall"], parameters, signal);
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/libraries">>} */
export const libraries = (signal) => get(["libraries"], { limit: 1000 }, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/libraries/{library}">>} */
export const library = (id, signal) => get(["libraries", id], {}, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/libraries/{library}/states">>} */
export const libraryStates = (id, signal) => get(["libraries", id, "states"], {}, signal);
/** @type {(id: string, index: number, signal?: AbortSignal) => Promise<Answer<"/v1/libraries/{library}/states/{state}">>} */
export const libraryState = (id, index, signal) =>
  get(["libraries", id, "states", String(index)], {}, signal);
/** @type {(id: string, depth: number, signal?: AbortSignal) => Promise<Answer<"/v1/libraries/{library}/flank">>} */
export const flank = (id, depth, signal) => get(["libraries", id, "flank"], { wear_um: depth }, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/streams">>} */
export const streams = (id, signal) => get(["assets", id, "streams"], {}, signal);
/** @type {(id: string, name: string, from: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/stream/levels">>} */
export const streamLevels = (id, name, from, signal) =>
  get(["assets", id, "stream", "levels"], { name, from }, signal);
export const keepStream = (id, name, seconds) =>
  send("POST", ["assets", id, "stream", "keep"], undefined, { parameters: { name, seconds } });
/** @type {(body: RequestBody<"/v1/assets", "post">) => Promise<any>} */
export const createAsset = (body) => send("POST", ["assets"], body);
export const deleteAsset = (id) => send("DELETE", ["assets", id]);

/** Columns of a CSV file, from the whole lines at its start. */
export const previewCsv = (lines, parameters) =>
  send("POST", ["csv-preview"], lines, { parameters, type: "text/csv" });

/** Contents of a MATLAB file, a protobuf block or the start of an MCAP recording. */
export const previewRecording = (body, type, parameters) =>
  send("POST", ["recording-preview"], body, { parameters, type });
/** @type {(body: RequestBody<"/v1/preview", "post">, signal?: AbortSignal) => Promise<any>} */
export const preview = (body, signal) => send("POST", ["preview"], body, { signal });
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/pair-presets">>} */
export const pairPresets = (signal) => get(["pair-presets"], {}, signal);
/**
 * Replaces a description, unless it has changed since the response `known`; that is an error with status 412.
 * @type {(id: string, body: RequestBody<"/v1/assets/{asset}", "put">, known: object) => Promise<any>}
 */
export const replaceAsset = (id, body, known) => send("PUT", ["assets", id], body, { known });
/** @type {(id: string, from?: number, to?: number, points?: number, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/spectrum">>} */
export const spectrum = (id, from, to, points, signal) =>
  get(["segments", id, "spectrum"], { from_hz: from, to_hz: to, max_points: points }, signal);
/** @type {(id: string, from?: number, to?: number, points?: number, signal?: AbortSignal, band?: number[]) => Promise<Answer<"/v1/segments/{segment}/envelope">>} */
export const envelope = (id, from, to, points, signal, band) =>
  get(
    ["segments", id, "envelope"],
    { from_hz: from, to_hz: to, max_points: points, band_low_hz: band?.[0], band_high_hz: band?.[1] },
    signal,
  );
/** @type {(id: string, from: number, to: number, signal?: AbortSignal) => Promise<Answer<"/v1/segments/{segment}/waveform">>} */
export const samples = (id, from, to, signal) =>
  get(["segments", id, "waveform"], { max_points: 200_000, from_s: from, to_s: to }, signal);
/** @type {(parameters: object, signal?: AbortSignal) => Promise<Answer<"/v1/alarms">>} */
export const alarms = (parameters, signal) => get(["alarms"], parameters, signal);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/alarms/{alarm}">>} */
export const alarm = (id, signal) => get(["alarms", id], {}, signal);
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/notifications">>} */
export const notifications = (signal) => get(["notifications"], {}, signal);
/**
 * @template {"acknowledge" | "shelve" | "unshelve" | "comment"} A
 * @param {string} id
 * @param {A} action
 * @param {RequestBody<`/v1/alarms/{alarm}/${A}`, "post">} body
 */
export const actOnAlarm = (id, action, body) => send("POST", ["alarms", id, action], body);
/** @type {(id: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/maintenance">>} */
export const maintenance = (id, signal) => get(["assets", id, "maintenance"], { limit: 200 }, signal);
/** @type {(id: string, body: RequestBody<"/v1/assets/{asset}/maintenance", "post">) => Promise<any>} */
export const addMaintenance = (id, body) => send("POST", ["assets", id, "maintenance"], body);
export const deleteMaintenance = (id, event) => send("DELETE", ["assets", id, "maintenance", event]);
/** @type {(id: string, parameters: object, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/segments">>} */
export const recordsPage = (id, parameters, signal) => get(["assets", id, "segments"], parameters, signal);
/** @type {(id: string, parameters: object, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/segments/count">>} */
export const recordCount = (id, parameters, signal) =>
  get(["assets", id, "segments", "count"], parameters, signal);
/** `action` is "exclude" or "include"; `parameters` name a range or `ids`. */
export const markRecords = (id, action, parameters) =>
  send("POST", ["assets", id, "segments", action], undefined, { parameters });
export const deleteRecords = (id, parameters) =>
  send("DELETE", ["assets", id, "segments"], undefined, { parameters });
/** @type {(id: string, channel: string, name: string, signal?: AbortSignal) => Promise<Answer<"/v1/assets/{asset}/indicators/baseline">>} */
export const baseline = (id, channel, name, signal) =>
  get(["assets", id, "indicators", "baseline"], { channel, names: name }, signal);
/** @type {(id: string, body: RequestBody<"/v1/assets/{asset}/alarms/try", "post">, signal?: AbortSignal) => Promise<any>} */
export const tryRule = (id, body, signal) => send("POST", ["assets", id, "alarms", "try"], body, { signal });
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/tokens">>} */
export const tokens = (signal) => get(["tokens"], { limit: 1000 }, signal);
/** @type {(body: RequestBody<"/v1/tokens", "post">) => Promise<any>} */
export const createToken = (body) => send("POST", ["tokens"], body);
export const revokeToken = (id) => send("DELETE", ["tokens", id]);
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/replays">>} */
export const replays = (signal) => get(["replays"], { limit: 100 }, signal);
/** @type {(signal?: AbortSignal) => Promise<Answer<"/v1/replay-files">>} */
export const replayFiles = (signal) => get(["replay-files"], {}, signal);
/** @type {(body: RequestBody<"/v1/replays", "post">) => Promise<any>} */
export const startReplay = (body) => send("POST", ["replays"], body);
export const stopReplay = (id) => send("DELETE", ["replays", id]);

/**
 * Resolves to the response, or to the server's error as a value; a lost connection still throws.
 * @template T
 * @param {Promise<T>} promise
 * @returns {Promise<T | ApiError>}
 */
export async function settle(promise) {
  try {
    return await promise;
  } catch (error) {
    if (error instanceof ApiError) return error;
    throw error;
  }
}
