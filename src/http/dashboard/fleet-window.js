// Row virtualisation: only visible rows of a long table are in the page; empty rows keep the scroll height.

import { h } from "./dom.js";

const BEYOND = 6; // rows above and below the view and the focus, for slow scrolling and the Tab key

/**
 * Shows `items` as rows of `body`. `draw(item)` returns the row element, `kind(item)` a key shared by rows of
 * the same height.
 */
export class RowWindow {
  #body;
  #table;
  #draw;
  #kind;
  #items = [];
  #tops = [0];
  #heights = new Map();
  #everything = false;
  #frame = 0;
  #shown = [];
  #ending = new AbortController();

  constructor(table, body, draw, kind) {
    [this.#table, this.#body, this.#draw, this.#kind] = [table, body, draw, kind];
    const { signal } = this.#ending;
    addEventListener("scroll", () => this.#soon(), { signal, passive: true });
    addEventListener("resize", () => this.#resized(), { signal });
    addEventListener("beforeprint", () => this.#all(true), { signal });
    addEventListener("afterprint", () => this.#all(false), { signal });
    body.addEventListener("keydown", (event) => this.#walk(event), { signal });
    body.addEventListener("focusin", () => this.#render(), { signal }); // so that the next Tab finds its row without waiting for a frame
  }

  /** Shows other items, or the same ones again. */
  show(items) {
    this.#items = items;
    this.#table.setAttribute("aria-rowcount", String(items.length + 1)); // including the heading row
    this.#place();
    this.#render();
  }

  /** The items whose rows are in the page. */
  get shown() {
    return this.#shown.map((index) => this.#items[index]).filter(Boolean);
  }

  /** Removes the listeners. */
  dispose() {
    this.#ending.abort();
    cancelAnimationFrame(this.#frame);
  }

  #soon() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      this.#render();
    });
  }

  #resized() {
    this.#heights.clear();
    this.#place();
    this.#soon();
  }

  #all(is) {
    this.#everything = is;
    this.#render();
  }

  #place() {
    this.#tops = [0];
    for (const item of this.#items)
      this.#tops.push(this.#tops.at(-1) + (this.#heights.get(this.#kind(item)) ?? 80));
  }

  /** The first row that ends below `y`, in pixels of the table. */
  #at(y) {
    let [low, high] = [0, this.#items.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.#tops[middle + 1] <= y) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  #wanted() {
    const count = this.#items.length;
    if (this.#everything) return this.#items.map((_, index) => index);
    const top = -this.#body.getBoundingClientRect().top;
    const from = Math.max(0, Math.min(this.#at(top), count - 1) - BEYOND);
    const to = Math.min(count, this.#at(top + innerHeight) + 1 + BEYOND);
    const wanted = new Set();
    for (let index = from; index < to; index++) wanted.add(index);
    // Keep the focused row and its neighbours, wherever the page is scrolled to
    const held = this.#body.contains(document.activeElement) ? document.activeElement : null;
    const focused = held ? this.#items.findIndex((item) => this.#draw(item, true)?.contains(held)) : -1;
    if (focused >= 0) {
      for (let index = Math.max(0, focused - BEYOND); index <= Math.min(count - 1, focused + BEYOND); index++)
        wanted.add(index);
    }
    return [...wanted].sort((a, b) => a - b);
  }

  #render() {
    const wanted = this.#wanted();
    const elements = [];
    let next = 0;
    for (const index of wanted) {
      if (index > next) elements.push(this.#gap(next, index));
      const element = this.#draw(this.#items[index]);
      element.setAttribute("aria-rowindex", String(index + 2));
      elements.push(element);
      next = index + 1;
    }
    if (next < this.#items.length) elements.push(this.#gap(next, this.#items.length));
    this.#shown = wanted;
    this.#put(elements);
    if (this.#measure(wanted)) {
      this.#place();
      this.#render();
    }
  }

  /** Inserts rows in order without touching rows already in place: moving a row would lose its focus. */
  #put(elements) {
    const staying = new Set(elements);
    for (const child of [...this.#body.children]) if (!staying.has(child)) child.remove();
    let at = this.#body.firstChild;
    for (const element of elements) {
      if (element === at) at = at.nextSibling;
      else this.#body.insertBefore(element, at);
    }
  }

  #gap(from, to) {
    const height = this.#tops[to] - this.#tops[from];
    return h("tr", { class: "gap", "aria-hidden": "true", style: `height:${height}px` }, h("td"));
  }

  /** Measures the row height of each kind; returns whether a kind was new. */
  #measure(indices) {
    let learned = false;
    for (const index of indices) {
      const kind = this.#kind(this.#items[index]);
      if (this.#heights.has(kind)) continue;
      const { height } = this.#draw(this.#items[index]).getBoundingClientRect();
      if (!height) continue;
      this.#heights.set(kind, height);
      learned = true;
    }
    return learned;
  }

  /** Arrow keys, Home and End move between rows. */
  #walk(event) {
    const at = this.#items.findIndex((item) => this.#draw(item, true)?.contains(event.target));
    const last = this.#items.length - 1;
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: last }[event.key];
    if (at < 0 || to === undefined || to < 0 || to > last || event.altKey || event.ctrlKey || event.metaKey)
      return;
    event.preventDefault();
    const top = this.#body.getBoundingClientRect().top + scrollY + this.#tops[to];
    const above = document.querySelector(".topbar")?.getBoundingClientRect().height ?? 0;
    if (top < scrollY + above) scrollTo(0, top - above);
    else if (top + 120 > scrollY + innerHeight) scrollTo(0, top + 120 - innerHeight);
    this.#render();
    this.#draw(this.#items[to]).querySelector("a, button")?.focus({ preventScroll: true });
  }
}
