// A thumbnail of a waveform from its minima and maxima.

import { svg } from "./dom.js";
import { number } from "./format.js";

const [WIDTH, HEIGHT] = [240, 44];

/** An envelope, one `[low, high]` per column, as SVG; null when it contains no number. */
export function sketch({ columns }, label) {
  const finite = columns.filter(([low, high]) => Number.isFinite(low) && Number.isFinite(high));
  if (finite.length === 0) return null;
  const low = Math.min(...finite.map(([value]) => value));
  const high = Math.max(...finite.map(([, value]) => value));
  const y = (value) => (high > low ? HEIGHT - 2 - ((HEIGHT - 4) * (value - low)) / (high - low) : HEIGHT / 2);
  const x = (n) => (columns.length > 1 ? (n * WIDTH) / (columns.length - 1) : WIDTH / 2);
  const upper = columns.map(([, value], n) => `${x(n).toFixed(1)} ${(y(value) - 0.4).toFixed(1)}`);
  const lower = columns.map(([value], n) => `${x(n).toFixed(1)} ${(y(value) + 0.4).toFixed(1)}`).reverse();
  const words = `Waveform of ${label}, from ${number(low, 3)} to ${number(high, 3)}`;
  return svg(
    "svg",
    {
      class: "sketch",
      viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
      role: "img",
      "aria-label": words,
      preserveAspectRatio: "none",
    },
    svg("path", { d: `M${[...upper, ...lower].join("L")}Z` }),
  );
}
