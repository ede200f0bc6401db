// Builds elements without markup strings, so that external text is never parsed as markup.

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

/** Creates an HTML element; functions such as `onclick` become listeners, everything else an attribute. */
export function h(tag, properties, ...children) {
  return fill(document.createElement(tag), properties, children);
}

/** Creates an SVG element. */
export function svg(tag, properties, ...children) {
  return fill(document.createElementNS(SVG, tag), properties, children);
}

/** The `data-` attribute `name` of the focused element; undefined when it has none. */
export const focusedData = (name) =>
  document.activeElement instanceof HTMLElement ? document.activeElement.dataset[name] : undefined;

/** Sets the options of a select, `[value, text]` each, if they have changed: new ones would close its list. */
export function setOptions(select, options) {
  const wanted = JSON.stringify(options);
  if (select.dataset.options === wanted) return;
  select.dataset.options = wanted;
  select.replaceChildren(...options.map(([value, text]) => h("option", { value }, text)));
}

/** Sets an element's text only if it differs, to keep text selections and avoid repeated announcements. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Replaces an element's children. */
export function setChildren(element, ...children) {
  element.replaceChildren(...children.flat().filter(Boolean));
}

/** The head of a table: one row of titles, or cells where they are elements. */
export const tableHead = (titles) =>
  h(
    "thead",
    {},
    h(
      "tr",
      {},
      titles.map((title) => (typeof title === "string" ? h("th", { scope: "col" }, title) : title)),
    ),
  );
