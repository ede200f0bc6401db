// What the pointer does on a still plot while the plotting library loads, for the plot that takes its place: a
// click or a drag may begin before the library is there.

const NOTED = ["mousemove", "mousedown", "mouseup"];

/** Notes the mouse events on an element from now on; the returned function repeats them on what is there then. */
export function recordPointer(element) {
  /** @type {MouseEvent[]} */
  const events = [];
  const isPressed = () => events.filter(({ type }) => type !== "mousemove").at(-1)?.type === "mousedown";
  const note = (event) => {
    if (!isPressed() && !element.contains(event.target)) return;
    // between presses only the last place counts
    if (event.type === "mousemove" && events.at(-1)?.type === "mousemove") events.pop();
    events.push(event);
  };
  for (const type of NOTED) document.addEventListener(type, note, { capture: true });
  return () => {
    for (const type of NOTED) document.removeEventListener(type, note, { capture: true });
    const isThere = element.matches(":hover");
    if (!isThere && events.every(({ type }) => type === "mousemove")) return;
    let target = element;
    for (const event of events) {
      const { type, clientX, clientY, button, buttons, detail, shiftKey, ctrlKey, altKey, metaKey } = event;
      const where = { clientX, clientY, button, buttons, detail, shiftKey, ctrlKey, altKey, metaKey };
      target = document.elementFromPoint(clientX, clientY) ?? target;
      target.dispatchEvent(new MouseEvent(type, { bubbles: true, cancelable: true, view: window, ...where }));
    }
    if (!isThere) target.dispatchEvent(new MouseEvent("mouseout", { bubbles: true, view: window }));
  };
}
