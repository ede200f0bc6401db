// Symbols of states. Each severity has its own colour, outline and glyph, so that none depends on colour
// alone; the small signal is that of NAMUR NE 107, in the recommended colours.

import { h, svg } from "./dom.js";
import { STATES } from "./state.js";

const ROUND = "M12 2a10 10 0 1 0 0 20a10 10 0 1 0 0-20z";

const SEVERITIES = {
  normal: [ROUND, "M7.500 12.300l3.200 3.200 5.800-6.500"],
  warning: [
    "M4 3h16a1 1 0 0 1 1 1v16a1 1 0 0 1-1 1H4a1 1 0 0 1-1-1V4a1 1 0 0 1 1-1z",
    "M12 7v6M12 16.600v.2",
  ],
  danger: [
    "M8 1.800h8L22.200 8v8L16 22.200H8L1.800 16V8z",
    "M8.300 8.300l7.400 7.400M15.700 8.300l-7.400 7.400",
  ],
  unsure: [
    "M12 1.200L22.800 12 12 22.800 1.200 12z",
    "M9.500 9.700a2.600 2.600 0 1 1 3.700 2.500c-.8.400-1.200.8-1.200 1.600M12 17v.2",
  ],
  learning: [ROUND, "M12 6.500v5.800l3.600 2.200"],
  none: ["M12 2.500a9.500 9.500 0 1 0 0 19a9.500 9.500 0 1 0 0-19z", "M8 12h8"],
};

const SIGNALS = {
  failure: {
    words: "NE 107 failure",
    outline: ROUND,
    glyph: "M8.300 8.300l7.400 7.400M15.700 8.300l-7.400 7.400",
  },
  check: { words: "NE 107 function check", outline: "M1 3h22L12 22z", glyph: "M12 6.500v5M12 15v.2" },
  specification: {
    words: "NE 107 out of specification",
    outline: "M12 2l11 19H1z",
    glyph: "M10 11.300a2.100 2.100 0 1 1 3 2c-.7.300-1 .7-1 1.300M12 17.600v.2",
  },
  maintenance: {
    words: "NE 107 maintenance required",
    outline: "M12 1l11 11-11 11L1 12z",
    glyph: "M12 6.500c2.200 3 3.200 4.600 3.200 6.200a3.200 3.200 0 0 1-6.400 0c0-1.600 1-3.200 3.200-6.200z",
  },
};

function drawn(classes, outline, glyph, size, properties) {
  return svg(
    "svg",
    { class: classes, viewBox: "0 0 24 24", width: size, height: size, ...properties },
    svg("path", { class: "outline", d: outline }),
    svg("path", { class: "glyph", d: glyph }),
  );
}

/** The symbol of a state's severity; hidden from screen readers, because its label is beside it. */
export function symbol(key, size = 22) {
  const { severity } = STATES[key];
  const [outline, glyph] = SEVERITIES[severity];
  return drawn(`symbol symbol-${severity}`, outline, glyph, size, { "aria-hidden": "true" });
}

/** The NE 107 signal of a state, or null. */
function signal(key, size) {
  const { words, outline, glyph } = SIGNALS[STATES[key].namur] ?? {};
  if (!words) return null;
  return h(
    "span",
    { class: "namur-box", title: words },
    drawn(`namur namur-${STATES[key].namur}`, outline, glyph, size, { role: "img", "aria-label": words }),
  );
}

/** Symbol, label and NE 107 signal together; the label defaults to the state's. */
export function badge(key, size = 22, word = STATES[key].word) {
  const { severity, title } = STATES[key];
  return h(
    "span",
    { class: "badge", "data-state": key, "data-severity": severity, title },
    symbol(key, size),
    h("span", {}, word),
    signal(key, Math.round(0.75 * size)),
  );
}
