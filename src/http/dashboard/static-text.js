// Sizes of text, and of the labels of a plot that is drawn without the plotting library.

const pen = document.createElement("canvas").getContext("2d");
const known = new Map();

/** The width of a text and the height above and below its baseline, in pixels. */
export function textSize(text, { size, family }) {
  const key = `${size} ${family} ${text}`;
  if (!known.has(key)) {
    pen.font = `${size}px ${family}`;
    const { width, fontBoundingBoxAscent: ascent, fontBoundingBoxDescent: descent } = pen.measureText(text);
    known.set(key, { width, ascent: Math.round(ascent), descent: Math.round(descent) });
  }
  return known.get(key);
}

export const LINE = 1.3; // height of a line relative to its font

/** The lines of a label. */
export const linesOf = (text) => text.split("<br>");

const FRACTIONS = { left: 0, center: 0.5, right: 1, top: 0, middle: 0.5, bottom: 1 };

/** How much of a label stands before its position; without an anchor a third of the plot decides. */
function fraction(anchor, position, isOnPaper) {
  if (anchor && anchor !== "auto") return FRACTIONS[anchor];
  if (!isOnPaper) return 0.5;
  return position < 1 / 3 ? 0 : position > 2 / 3 ? 1 : 0.5;
}

/**
 * The box of an annotation: its size as written, `edge` around the text, and per axis how far it reaches
 * before and after its position, upright or turned.
 */
export function annotationBox(annotation, font) {
  const own = { ...font, size: annotation.font?.size ?? font.size };
  const lines = linesOf(annotation.text);
  const sizes = lines.map((line) => textSize(line, own));
  const { ascent, descent } = sizes[0];
  const edge = 1 + (annotation.borderpad ?? 1);
  const width = Math.round(Math.max(...sizes.map((each) => each.width)) + 2 * edge);
  const height = Math.round(ascent + descent + LINE * own.size * (lines.length - 1) + 2 * edge);
  const isTurned = Boolean(annotation.textangle);
  const [across, upright] = isTurned ? [height, width] : [width, height];
  const left = fraction(annotation.xanchor, annotation.x, annotation.xref === "paper") * across;
  const isOnPaper = annotation.yref === "paper";
  const above = fraction(annotation.yanchor, 1 - annotation.y, isOnPaper) * upright;
  return {
    lines,
    size: own.size,
    ascent,
    edge,
    width,
    height,
    x: { before: left, after: across - left },
    y: { before: upright - above, after: above },
  };
}
