// The rows of a list. A row stays the same element while its contents stay the same, and a row that is built
// again keeps the focus: updates arrive while the keyboard is in use.

const CONTROLS = "a[href], button, input, select, textarea";

/** The control that has the focus in `parent`: its row's key and place, and its place in the row. */
function heldIn(parent, rows) {
  const active = document.activeElement;
  if (!parent.contains(active)) return null;
  const entries = [...rows];
  const place = entries.findIndex(([, { element }]) => element.contains(active));
  if (place < 0) return null;
  const [key, { element }] = entries[place];
  return { key, place, control: [...element.querySelectorAll(CONTROLS)].indexOf(active) };
}

/** Puts the children of `parent` in order without moving those already in place: moving one loses its focus. */
function arrange(parent, elements) {
  const staying = new Set(elements);
  for (const child of [...parent.children]) if (!staying.has(child)) child.remove();
  let at = parent.firstElementChild;
  for (const element of elements) {
    if (element === at) at = at.nextElementSibling;
    else parent.insertBefore(element, at);
  }
}

/** Rows of `parent`: `keyOf(item)` identifies an item, `make(item)` builds its row. */
export class KeyedRows {
  #parent;
  #keyOf;
  #make;
  #rows = new Map(); // key → { contents, element }

  constructor(parent, keyOf, make) {
    [this.#parent, this.#keyOf, this.#make] = [parent, keyOf, make];
  }

  /** Shows `items`; a row is built again when the text of `contentsOf(item)` changes. */
  show(items, contentsOf = JSON.stringify) {
    const held = heldIn(this.#parent, this.#rows);
    const rows = new Map();
    for (const item of items) {
      const key = this.#keyOf(item);
      const contents = contentsOf(item);
      const known = this.#rows.get(key);
      rows.set(key, known?.contents === contents ? known : { contents, element: this.#make(item) });
    }
    this.#rows = rows;
    const elements = [...rows.values()].map(({ element }) => element);
    arrange(this.#parent, elements);
    if (!held) return;
    // The focus of a removed row moves to the one in its place
    const row = rows.get(held.key)?.element ?? elements[Math.min(held.place, elements.length - 1)];
    const controls = row ? [...row.querySelectorAll(CONTROLS)] : [];
    const control = controls[Math.min(held.control, controls.length - 1)];
    if (control && control !== document.activeElement) control.focus({ preventScroll: true });
  }
}
