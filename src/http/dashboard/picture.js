// Exports a plot as a self-contained picture on white, with title, asset, time, description and legend.

import { pictureOf } from "./plots.js";
import { colours } from "./theme.js";

const SCALE = 2; // picture pixels per page pixel
const MARGIN = 14;
const [TITLE, WORDS] = [
  { size: 17, line: 24 },
  { size: 12.5, line: 18 },
];
const SWATCH = { width: 24, height: 14 };

function loaded(address) {
  return new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error("failed to draw the picture"));
    image.src = address;
  });
}

/** The legend entries with their swatches as images. */
function entriesOf(list) {
  return Promise.all(
    [...list.children].map(async (item) => {
      const source = new XMLSerializer().serializeToString(item.querySelector("svg"));
      return {
        words: item.textContent,
        swatch: await loaded(`data:image/svg+xml;charset=utf-8,${encodeURIComponent(source)}`),
      };
    }),
  );
}

/** Wraps text into lines of a width. */
function wrapped(context, text, width) {
  const lines = [];
  for (const word of text.split(/\s+/).filter(Boolean)) {
    const longer = lines.length ? `${lines.at(-1)} ${word}` : word;
    if (lines.length && context.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}

/** The text above the plot as drawing steps, and its height. */
function headOf(context, family, { title, subject, sub, entries }, width, { ink, muted }) {
  const steps = [];
  let y = MARGIN;
  const write = (text, { size, line }, weight, colour) => {
    const font = `${weight} ${size}px ${family}`;
    context.font = font;
    for (const words of wrapped(context, text, width - 2 * MARGIN)) {
      const at = y;
      steps.push(() => Object.assign(context, { font, fillStyle: colour }).fillText(words, MARGIN, at));
      y += line;
    }
  };
  write(title, TITLE, 600, ink);
  write(subject, WORDS, 600, ink);
  write(sub, WORDS, 400, muted);
  context.font = `400 ${WORDS.size}px ${family}`;
  let x = MARGIN;
  for (const { words, swatch } of entries) {
    const long = SWATCH.width + 6 + context.measureText(words).width;
    if (x > MARGIN && x + long > width - MARGIN) [x, y] = [MARGIN, y + WORDS.line];
    const [left, top] = [x, y];
    steps.push(() => {
      context.drawImage(swatch, left, top, SWATCH.width, SWATCH.height);
      Object.assign(context, { font: `400 ${WORDS.size}px ${family}`, fillStyle: ink }).fillText(
        words,
        left + SWATCH.width + 6,
        top,
      );
    });
    x += long + 16;
  }
  if (entries.length) y += WORDS.line;
  return { steps, height: y + 6 };
}

/** Saves a plot drawn by `drawing`, with title, subject, description and the page's legend list. */
export async function savePicture(plot, { title, subject, sub, legend }, filename, drawing) {
  const colour = colours("ink", "muted", "surface");
  const family = getComputedStyle(document.body).fontFamily;
  const [curves, entries] = await Promise.all([
    pictureOf(plot, SCALE, drawing).then(loaded),
    entriesOf(legend),
  ]);
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const { clientWidth: width, clientHeight: height } = plot;
  const head = headOf(context, family, { title, subject, sub, entries }, width, colour);
  Object.assign(canvas, { width: SCALE * width, height: SCALE * (head.height + height) });
  Object.assign(context, { textBaseline: "top", fillStyle: colour.surface });
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.scale(SCALE, SCALE);
  for (const step of head.steps) step();
  context.drawImage(curves, 0, head.height, width, height);
  const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  const link = Object.assign(document.createElement("a"), {
    href: URL.createObjectURL(blob),
    download: `${filename}.png`,
  });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
