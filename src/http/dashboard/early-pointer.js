// What the pointer does on a static plot while the plotting library loads, for the plot that takes its place:
// a click or a drag may begin before the library is there.

const RECORDED = ["mousemove", "mousedown", "mouseup"];
const RECENT_MS = 15_000; // what is older was given up

/**
 * Records the mouse events on an element from now on; the returned function repeats them on what is there then.
 */
export function recordEarlyEvents(element) {
  /** @type {MouseEvent[]} */
  let events = [];
  let isPressed = false;
  const listen = (isOn) => {
    for (const type of RECORDED)
      if (isOn) document.addEventListener(type, record, { capture: true });
      else document.removeEventListener(type, record, { capture: true });
  };
  const record = (event) => {
    if (!element.isConnected) return listen(false);
    // A drag may end beside the element
    if (!isPressed && !element.contains(event.target)) return;
    if (event.type !== "mousemove") isPressed = event.type === "mousedown";
    // Between presses only the last place counts
    if (event.type === "mousemove" && events.at(-1)?.type === "mousemove") events.pop();
    events.push(event);
  };
  listen(true);
  return () => {
    listen(false);
    events = events.filter(({ timeStamp }) => performance.now() - timeStamp < RECENT_MS);
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
