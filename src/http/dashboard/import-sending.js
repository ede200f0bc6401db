// Uploads one file: request parameters, progress, and the result as text.

import { address, ConnectionError, failure, recordsPage } from "./api.js";
import { clock } from "./format.js";
import { csvParameters } from "./import-preview.js";
import { depthWords, ended } from "./state.js";

const PCM = 1;
const OF_SAMPLES = ["audio/wav", "audio/flac", "text/csv", "application/x-matlab-data", "application/x-npy"];

/** Whether a file has integers, which a full scale converts to values. */
export const hasIntegers = ({ type, head }) => type === "audio/flac" || head?.format === PCM;

/** Whether a file's values may be volts, which a sensitivity converts to g. */
export const hasVolts = ({ type }) => OF_SAMPLES.includes(type);

/** Sends a body and reports its progress, which fetch does not for uploads. */
function send(href, body, type, onProgress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", href);
    request.setRequestHeader("content-type", type);
    request.setRequestHeader("accept", "application/json");
    request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(loaded / total));
    request.addEventListener("load", () =>
      request.status < 300
        ? resolve(JSON.parse(request.responseText))
        : reject(failure(request.status, request.responseText)),
    );
    request.addEventListener("error", () => reject(new ConnectionError("connection lost during the upload")));
    request.send(body);
  });
}

const list = (names) => names.map((name) => name.replaceAll(",", " ")).join(",");

/** The channel names as parameters; unnamed channels of several have the names in the file. */
function named(channels) {
  const names = channels.map(({ name }) => name);
  if (names.every((name) => !name)) return {};
  if (names.length === 1) return { channel: names[0] };
  return { channel_names: list(channels.map(({ name, recorded }, n) => name || recorded || String(n + 1))) };
}

/** The names and units of channels; `unit` is that of channels without one of their own. */
function withUnits(channels, unit) {
  const units = channels.map((channel) => channel.unit);
  if (!units.some(Boolean)) return { unit, ...named(channels) };
  if (channels.length === 1) return { unit: units[0], ...named(channels) };
  const all = channels.map((channel) => ({ ...channel, name: channel.name || channel.recorded }));
  return { unit, ...named(all), channel_units: list(units) };
}

/** The new names and units of an MCAP recording's channels; nothing when none was entered. */
function renamed(channels, unit) {
  // A name with a comma cannot be listed
  const known = channels.filter(({ recorded }) => recorded && !recorded.includes(","));
  if (!known.some((channel) => channel.name || channel.unit || unit)) return {};
  return {
    recorded_channels: list(known.map(({ recorded }) => recorded)),
    channel_names: list(known.map(({ name, recorded }) => name || recorded)),
    channel_units: list(known.map((channel) => channel.unit || unit)),
  };
}

/**
 * The requests for a file, each `{ body, type, parameters }`. `entry` has what was entered for it: `start`,
 * `channels` with `name`, `unit` and `recorded`, `fullScale` and `roles`; `common` has the values for all files.
 */
async function requestsOf(file, seen, entry, common) {
  const { type } = seen;
  const { unit, rate, fullScale, sensitivity, ...point } = common;
  const parameters = {
    ...point,
    start_time: entry.start,
    scale: hasIntegers(seen) ? entry.fullScale || fullScale : undefined,
    sensitivity_mv_per_g: hasVolts(seen) ? sensitivity : undefined,
  };
  if (type === "text/csv") {
    const groups = Map.groupBy(entry.channels, (channel) => channel.unit || unit);
    const csv = csvParameters(rate, entry.roles);
    if (groups.size < 2)
      return [
        {
          body: file,
          type,
          parameters: {
            ...parameters,
            ...csv,
            unit: [...groups.keys()][0] ?? unit,
            ...named(entry.channels),
          },
        },
      ];
    return [...groups].map(([own, channels]) => ({
      body: file,
      type,
      parameters: {
        ...parameters,
        ...csv,
        columns: channels.map(({ place }) => place + 1).join(","),
        unit: own,
        ...named(channels),
      },
    }));
  }
  if (["application/x-matlab-data", "application/x-npy"].includes(type)) parameters.sample_rate_hz = rate;
  else if (type === "application/mcap")
    return [{ body: file, type, parameters: renamed(entry.channels, unit) }];
  else if (!type.startsWith("audio/")) return [{ body: file, type, parameters: {} }];
  return [{ body: file, type, parameters: { ...parameters, ...withUnits(entry.channels, unit) } }];
}

/** The ids of an asset's records with a given start. */
export async function recordsAt(asset, start, signal) {
  const to = new Date(Date.parse(start) + 1).toISOString();
  return (await recordsPage(asset, { from: start, to, limit: 100 }, signal)).items;
}

/**
 * Uploads a file. Returns `{ kind, words, segments, repeated }`: the ids of the new records, and how many were
 * stored already.
 */
export async function sendFile(asset, file, seen, entry, common, onProgress) {
  const start = entry.start ?? seen.ownStart;
  const before = start ? new Set((await recordsAt(asset, start)).map(({ id }) => id)) : null;
  const requests = await requestsOf(file, seen, entry, common);
  const all = { kind: "good", words: [], segments: [], repeated: 0 };
  for (const [n, { body, type, parameters }] of requests.entries()) {
    let response;
    try {
      response = await send(address(["assets", asset, "segments"], parameters), body, type, (share) =>
        onProgress((n + share) / requests.length),
      );
    } catch (error) {
      if (n === 0) throw error;
      // The records of the requests before are stored
      const part = `The part of ${file.name} ${parameters.unit ? `in ${parameters.unit}` : "without a unit"}`;
      return { ...all, kind: "part", words: [...all.words, ...refusalWords(part, error)] };
    }
    const refused = response.refused_count ?? 0;
    if (refused) all.kind = response.stored + response.repeated + (response.queued ?? 0) > 0 ? "part" : "bad";
    all.words.push(...words(file, response, before));
    const taken = (response.segments ?? [response]).map((segment) => segment.id ?? segment);
    all.repeated += response.repeated ?? taken.filter((id) => before?.has(id)).length;
    // For a single record of unknown start, the client cannot tell whether it is new
    if (before || response.records !== undefined)
      all.segments.push(...taken.filter((id) => !before?.has(id)));
    all.listed =
      (all.listed ?? true) &&
      (response.records === undefined ||
        response.segments.length === response.stored + (response.queued ?? 0));
  }
  return all;
}

/** The result as text; `before` has the ids of the records that were there. */
function words(file, response, before) {
  if (response.records !== undefined) {
    const queued = response.queued ? `, ${response.queued} queued for analysis` : "";
    const counts = `${file.name}: ${response.records} records read, ${response.stored} stored${queued}, ${response.repeated} already stored, ${response.refused_count} refused.`;
    const missing = response.missing_channels ?? [];
    return [
      counts,
      ...missing.map((name) => `No record of the file has the channel ${name}; nothing is renamed for it.`),
      ...response.refused
        .slice(0, 5)
        .map(
          ({ record, channel, reason }) =>
            `Record ${record}${channel ? `, channel ${channel}` : ""}: ${reason}.`,
        ),
    ];
  }
  return (response.segments ?? [response]).map(({ id, channel, start_time: start, wear, state }) => {
    const record = `${file.name}: record of ${clock(start)}, channel ${channel},`;
    if (before?.has(id)) return `${record} already stored, not added again.`;
    if (state === "queued") return `${record} accepted and queued for analysis; the page updates by itself.`;
    const { number, interval } = depthWords(wear);
    const estimate = wear.median_um == null ? wear.reason : `wear ${number} (${interval})`;
    return ended(`${record} stored; ${estimate}`);
  });
}

/** Describes a refused upload of `what`, or one that did not reach the server. */
export function refusalWords(what, error) {
  if (error instanceof ConnectionError) return [`${what} could not be sent: ${error.message}; try again.`];
  const { field, value, expected } = error.problem ?? {};
  const parts = [`${what} was rejected: ${error.message}`];
  if (expected && !error.message.includes(expected))
    parts.push(`${field ?? "value"} is ${JSON.stringify(value ?? null)}, expected ${expected}`);
  return parts;
}
