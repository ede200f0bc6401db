// Fault orders of rolling bearings, in multiples of the shaft speed, from their geometry; outer race fixed,
// no slip.

/**
 * The four fault lines: key and short name.
 * @type {[string, string][]}
 */
export const BEARING_LINES = [
  ["bpfo", "BPFO"],
  ["bpfi", "BPFI"],
  ["bsf", "BSF"],
  ["ftf", "FTF"],
];

/** Bearings of published test data sets with known geometry, in mm and degrees. */
export const KNOWN_BEARINGS = [
  { key: "6203", name: "6203 (SKF 6203-2RS)", elements: 8, roller: 6.746, pitch: 28.499, contact: 0 },
  { key: "6205", name: "6205 (SKF 6205-2RS)", elements: 9, roller: 7.94, pitch: 39.04, contact: 0 },
  { key: "6206", name: "6206", elements: 9, roller: 9.525, pitch: 46, contact: 0 },
  { key: "6804", name: "6804 (NSK 6804)", elements: 13, roller: 3.5, pitch: 25.6, contact: 0 },
  { key: "UER204", name: "UER204 (LDK)", elements: 8, roller: 7.92, pitch: 34.55, contact: 0 },
  { key: "ER16K", name: "ER-16K (MB)", elements: 9, roller: 7.94, pitch: 38.52, contact: 0 },
  { key: "ZA2115", name: "ZA-2115 (Rexnord)", elements: 16, roller: 8.407, pitch: 71.501, contact: 15.17 },
];

const MAX_ELEMENTS = 1000;

/**
 * The fault orders of a geometry: number of rolling elements, roller and pitch diameter, contact angle in
 * degrees.
 */
function ordersOfGeometry({ elements, roller, pitch, contact }) {
  const ratio = roller / pitch;
  const reach = ratio * Math.cos((contact * Math.PI) / 180);
  return {
    bpfo: 0.5 * elements * (1 - reach),
    bpfi: 0.5 * elements * (1 + reach),
    bsf: (0.5 / ratio) * (1 - reach ** 2),
    ftf: 0.5 * (1 - reach),
  };
}

/** An error message for an invalid geometry; empty when it is valid. */
export function geometryFault({ elements, roller, pitch, contact }) {
  if (!(Number.isInteger(elements) && elements >= 2 && elements <= MAX_ELEMENTS))
    return `Rolling elements: enter a whole number from 2 to ${MAX_ELEMENTS}.`;
  if (!(pitch > 0)) return "Pitch diameter: enter a value above 0 mm.";
  if (!(roller > 0 && roller < pitch))
    return "Rolling element diameter: enter a value above 0 mm and below the pitch diameter.";
  if (!(contact >= 0 && contact < 90)) return "Contact angle: enter at least 0° and less than 90°.";
  return "";
}

/**
 * Parses a bearing of an address: `6205`, `g~9~7.94~39.04~0` (geometry), or `o~3.58~5.42~2.36~0.398~name`
 * (orders); null for none.
 */
export function parseBearing(text) {
  const known = KNOWN_BEARINGS.find(({ key }) => key === text);
  if (known) return { key: text, name: known.name, orders: ordersOfGeometry(known), geometry: known };
  const [kind, ...parts] = (text ?? "").split("~");
  const [a, b, c, d] = parts.map(Number);
  if (kind === "g") {
    const geometry = { elements: a, roller: b, pitch: c, contact: d };
    return geometryFault(geometry)
      ? null
      : { key: "g", name: "custom geometry", orders: ordersOfGeometry(geometry), geometry };
  }
  const orders = { bpfo: a, bpfi: b, bsf: c, ftf: d };
  return kind === "o" && Object.values(orders).every((order) => order > 0)
    ? { key: text, name: parts.slice(4).join("~"), orders }
    : null;
}

/** Formats a geometry for an address. */
export const formatGeometry = ({ elements, roller, pitch, contact }) =>
  ["g", elements, roller, pitch, contact].join("~");

/** Formats an asset's bearing for an address. */
export const formatOrders = (name, orders) =>
  ["o", ...BEARING_LINES.map(([key]) => Number(orders[key].toPrecision(7))), name].join("~");
