// Spectra relative to the first record: the change in dB of each stretch of the axis.

import { number } from "./format.js";
import { recordColumns, recordEntries } from "./layers.js";

const STRETCHES = 400; // single lines of noise would differ by chance

/** The largest line of each stretch of `[from, to]`; undefined where a spectrum has none. */
function greatest({ frequency_hz: x, amplitude }, [from, to], count) {
  const peaks = Array(count).fill(undefined);
  const width = (to - from) / count;
  x.forEach((value, n) => {
    const stretch = Math.floor((value - from) / width);
    if (stretch < 0 || stretch >= count || amplitude[n] === null) return;
    if (!(peaks[stretch] >= amplitude[n])) peaks[stretch] = amplitude[n];
  });
  return peaks;
}

/**
 * Draws `layers` relative to the first of them, over a part of their axis.
 * @param {import("./layers.js").Layer[]} layers
 */
export function changeDrawing(layers, axis, range, note, revision) {
  const most = Math.max(
    ...layers.map(({ data }) => data.frequency_hz.filter((x) => x >= range[0] && x <= range[1]).length),
  );
  const fewest = Math.min(...layers.map(({ data }) => (range[1] - range[0]) / data.resolution_hz));
  const count = Math.max(1, Math.floor(Math.min(STRETCHES, most, fewest / 2)));
  const width = (range[1] - range[0]) / count;
  const x = Array.from({ length: count }, (_, n) => range[0] + (n + 0.5) * width);
  const [first] = layers.map(({ data }) => greatest(data, range, count));
  const changed = layers.map((layer) => ({
    ...layer,
    data: greatest(layer.data, range, count).map((peak, n) =>
      peak > 0 && first[n] > 0 ? 20 * Math.log10(peak / first[n]) : null,
    ),
  }));
  const heights = changed.flatMap(({ data }) => data).filter((level) => level !== null);
  const reach = 1.1 * Math.max(6, ...heights.map(Math.abs));
  const line = ({ data, colour, pointed }) => ({
    x,
    y: data,
    mode: "lines",
    line: { color: colour, width: 1.2 },
    hovertemplate: `${pointed}%{x:.2f}${axis.suffix}: %{y:+.1f} dB<extra></extra>`,
  });
  const compared = layers.length > 1 ? "" : " Add a second record to compare with the first.";
  return {
    traces: [line(changed[0])],
    others: changed.slice(1).map(line),
    table: () =>
      recordColumns(changed, (levels) => [
        [axis.name, x],
        ["level re first record (dB)", levels],
      ]),
    legend: recordEntries(layers),
    sub: `Largest line in each stretch of ${axis.wide(width)}, relative to the first record's largest line there (0 dB).${compared}${note}`,
    summary: `Levels relative to the first record from ${number(range[0])} to ${number(range[1])}.`,
    layout: {
      uirevision: revision,
      hovermode: "closest",
      hoverdistance: 12,
      xaxis: { title: { text: axis.title }, range, uirevision: `${revision} ${axis.name} ${range}` },
      yaxis: {
        title: { text: "Level re first record (dB)" },
        range: [-reach, reach],
        uirevision: `${revision} change ${range}`,
      },
    },
  };
}
