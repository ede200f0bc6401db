// State symbols: every category has its own colour, outline and glyph, so that none depends on colour alone.

import { h, svg } from "./dom.js";
import { STATES } from "./state.js";

const SHAPES = {
  normal: ["M12 2a10 10 0 1 0 0 20a10 10 0 1 0 0-20z", "M7.500 12.300l3.200 3.200 5.800-6.500"],
  maintenance: ["M4 3h16a1 1 0 0 1 1 1v16a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1V4a1 1 0 0 1 1-1z", "M12 7v6M12 16.600v.2"],
  failure: ["M8 1.800h8L22.200 8v8L16 22.200H8L1.800 16V8z", "M8.300 8.300l7.400 7.400M15.700 8.300l-7.400 7.400"],
  specification: ["M12 1.200L22.800 12 12 22.800 1.200 12z", "M9.500 9.700a2.600 2.600 0 1 1 3.700 2.500c-.8.400-1.200.8-1.200 1.600M12 17v.2"],
  check: ["M12 1.800L23 21.500H1z", "M12 9v4.500l2.800 2"],
  none: ["M12 2.500a9.500 9.500 0 1 0 0 19a9.500 9.500 0 1 0 0-19z", "M8 12h8"],
};

/** The symbol of a state, hidden from screen readers: its word stands beside it. */
export function symbol(key, size = 22) {
  const name = STATES[key].symbol;
  const [outline, glyph] = SHAPES[name];
  return svg(
    "svg",
    { class: `symbol symbol-${name}`, viewBox: "0 0 24 24", width: size, height: size, "aria-hidden": "true" },
    svg("path", { class: "outline", d: outline }),
    svg("path", { class: "glyph", d: glyph }),
  );
}

/** Symbol and word together. */
export function badge(key, size) {
  const { word, category } = STATES[key];
  return h("span", { class: "badge", "data-state": key, title: category }, symbol(key, size), h("span", {}, word));
}
