// CSV export for spreadsheets.

import { h } from "./dom.js";

function cell(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  const text = String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/**
 * Columns, each `[heading, values]`, as CSV text. `facts`, each `[name, value]`, are comment lines before the
 * header, which spreadsheets show and readers skip (`comment="#"`).
 */
function csvText(columns, facts = []) {
  const rows = Math.max(0, ...columns.map(([, values]) => values.length));
  const lines = facts.map(([name, value]) => `# ${name}: ${String(value).replaceAll(/\s+/g, " ")}`);
  lines.push(columns.map(([heading]) => cell(heading)).join(","));
  for (let row = 0; row < rows; row++) lines.push(columns.map(([, values]) => cell(values[row])).join(","));
  return `${lines.join("\r\n")}\r\n`;
}

/** Saves columns as a file, with `facts` before them. */
export function saveCsv(columns, name, facts) {
  const href = URL.createObjectURL(new Blob([csvText(columns, facts)], { type: "text/csv;charset=utf-8" }));
  const link = h("a", { href, download: `${name.replaceAll(":", "-")}.csv` });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(href), 10_000);
}
