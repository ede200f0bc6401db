// Light, dark or system theme; and the style sheet's colours as values, for plots.

import { h, setChildren } from "./dom.js";

const KEY = "flankwatch-theme";
const ORDER = ["auto", "light", "dark"];
const probe = document.createElement("span");

function stored() {
  try {
    const choice = localStorage.getItem(KEY);
    return ORDER.includes(choice) ? choice : "auto";
  } catch {
    return "auto"; // storage is unavailable in some private windows
  }
}

let choice = stored();

function apply() {
  if (choice === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = choice;
}

function announce() {
  document.dispatchEvent(new CustomEvent("themechange"));
}

/** Makes a button cycle through auto, light and dark. */
export function bindThemeButton(button) {
  const label = () => {
    setChildren(button, h("span", { class: "wide-only" }, "Theme: "), choice);
  };
  button.addEventListener("click", () => {
    choice = ORDER[(ORDER.indexOf(choice) + 1) % ORDER.length];
    try {
      localStorage.setItem(KEY, choice);
    } catch {
      // The choice then lasts until the page is closed
    }
    apply();
    label();
    announce();
  });
  label();
}

const known = new Map(); // colours read in this theme: reading one forces a style recalculation
document.addEventListener("themechange", () => known.clear(), { capture: true });

/** The current values of custom properties, as `rgb(…)`. */
export function colours(...names) {
  const key = `${probe.style.colorScheme} ${names}`;
  if (!known.has(key)) known.set(key, read(names));
  return known.get(key);
}

function read(names) {
  if (!probe.isConnected) {
    probe.hidden = true;
    document.body.append(probe);
  }
  return Object.fromEntries(
    names.map((name) => {
      probe.style.color = `var(--${name})`;
      return [name, getComputedStyle(probe).color];
    }),
  );
}

/** Runs a function with the colours of the light theme, whatever the current one. */
export function inLight(build) {
  probe.style.colorScheme = "light";
  try {
    return build();
  } finally {
    probe.style.colorScheme = "";
  }
}

/** An `rgb(…)` colour with an opacity. */
export function translucent(colour, opacity) {
  return colour.replace(/^rgb\(([^)]*)\)$/, `rgba($1, ${opacity})`);
}

apply();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", announce);
