// The name that a user signs actions with, stored in this browser.

const KEY = "flankwatch-by";

/** The last name used, or an empty string. */
export function storedName() {
  try {
    return localStorage.getItem(KEY) ?? "";
  } catch {
    return ""; // storage is unavailable in some private windows
  }
}

/** Stores a name for the next action. */
export function storeName(name) {
  try {
    localStorage.setItem(KEY, name);
  } catch {
    // The name then has to be entered again
  }
}
