// The records stored by the latest import into an asset. The browser keeps their ids, so that the import can
// be undone after the page is reloaded.

import { settle, ApiError, deleteRecords, segment } from "./api.js";

const RECORDS_PER_REQUEST = 200; // records named in one request

/** Deletes records and returns how many there were; records deleted by others meanwhile are left out. */
async function deleteExisting(asset, ids) {
  try {
    return (await deleteRecords(asset, { ids: ids.join(",") })).deleted;
  } catch (error) {
    if (error.status !== 404) throw error;
  }
  const existing = [];
  for (const id of ids) if (!((await settle(segment(id))) instanceof ApiError)) existing.push(id);
  return existing.length ? (await deleteRecords(asset, { ids: existing.join(",") })).deleted : 0;
}

/** The latest import into one asset. */
export class ImportBatch {
  #asset;
  #key;
  #ids = [];
  #at = "";
  /** When the import began, if it was before the page was loaded. @type {string | null} */
  since = null;

  constructor(asset) {
    this.#asset = asset;
    this.#key = `flankwatch-import-${asset}`;
    try {
      const { at, ids } = JSON.parse(localStorage.getItem(this.#key) ?? "{}");
      if (at && Array.isArray(ids)) [this.since, this.#at, this.#ids] = [at, at, ids];
    } catch {
      // No storage, or not ours: nothing can be undone
    }
  }

  get size() {
    return this.#ids.length;
  }

  /** Starts a new import; the one before can no longer be undone. */
  begin() {
    this.since = null;
    this.#at = new Date().toISOString();
    this.#set([]);
  }

  /** Adds stored records, also to what the browser keeps: the page may be left during the import. */
  add(ids) {
    this.#set([...this.#ids, ...ids]);
  }

  /** Deletes the records and returns their number; after a failure the rest can be deleted by another call. */
  async undo() {
    let deleted = 0;
    while (this.#ids.length) {
      deleted += await deleteExisting(this.#asset, this.#ids.slice(0, RECORDS_PER_REQUEST));
      this.#set(this.#ids.slice(RECORDS_PER_REQUEST));
    }
    return deleted;
  }

  #set(ids) {
    this.#ids = ids;
    try {
      if (ids.length === 0) localStorage.removeItem(this.#key);
      else localStorage.setItem(this.#key, JSON.stringify({ at: this.#at, ids }));
    } catch {
      // No storage, or no space left in it: undo then lasts until the page is left
    }
  }
}
