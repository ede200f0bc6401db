// CSV export for spreadsheets.

import { h } from "./dom.js";

function cell(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  const text = String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** Columns, each `[heading, values]`, as CSV text. */
export function csvText(columns) {
  const rows = Math.max(0, ...columns.map(([, values]) => values.length));
  const lines = [columns.map(([heading]) => cell(heading)).join(",")];
  for (let row = 0; row < rows; row++) lines.push(columns.map(([, values]) => cell(values[row])).join(","));
  return `${lines.join("\r\n")}\r\n`;
}

/** Saves columns as a file. */
export function saveCsv(columns, name) {
  const href = URL.createObjectURL(new Blob([csvText(columns)], { type: "text/csv" }));
  const link = h("a", { href, download: `${name.replaceAll(":", "-")}.csv` });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(href), 10_000);
}
