// Building elements without markup strings, so that no text from outside is ever read as markup.

const SVG = "http://www.w3.org/2000/svg";

function fill(element, properties, children) {
  for (const [name, value] of Object.entries(properties ?? {})) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(
    ...children.flat().filter((child) => child !== null && child !== undefined && child !== false),
  );
  return element;
}

/** An HTML element; `onclick` and the like take listeners, everything else is an attribute. */
export function h(tag, properties, ...children) {
  return fill(document.createElement(tag), properties, children);
}

/** An SVG element. */
export function svg(tag, properties, ...children) {
  return fill(document.createElementNS(SVG, tag), properties, children);
}

/** What the page's focus says about itself: the `data-` attribute of that name; undefined without one. */
export const focusedData = (name) =>
  document.activeElement instanceof HTMLElement ? document.activeElement.dataset[name] : undefined;

/** The same of what the focus is in, an element that a selector names. */
export function focusedIn(selector, name) {
  const around = document.activeElement?.closest(selector);
  return around instanceof HTMLElement ? around.dataset[name] : undefined;
}

/** Sets an element's text only where it differs, so that a selection in it and a screen reader are left in peace. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Replaces an element's children. */
export function setChildren(element, ...children) {
  element.replaceChildren(...children.flat().filter(Boolean));
}
