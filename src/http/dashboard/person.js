// The name that a person signs their actions with, kept in this browser.

const KEY = "flankwatch-by";

/** The name that was used last, or nothing. */
export function lastName() {
  try {
    return localStorage.getItem(KEY) ?? "";
  } catch {
    return ""; // storage is refused in some private windows
  }
}

/** Keeps a name for the next action. */
export function keepName(name) {
  try {
    localStorage.setItem(KEY, name);
  } catch {
    // it then has to be typed again
  }
}
