// The printable report: its form and its pages.

import assert from "node:assert/strict";
import { writeFile } from "node:fs/promises";
import { join } from "node:path";
import { asset, close, noSidewaysScrolling, open, PHONE, shots } from "./page.mjs";

/** Puts a link at the start and end of every unbreakable element: a PDF tells on which page a link is. */
const mark = (page) =>
  page.evaluate(() => {
    const whole = [...document.querySelectorAll("figure, tr, .signature, dl")];
    whole.forEach((element, n) => {
      const at = (end, side) => {
        const link = Object.assign(document.createElement("a"), { href: `https://marks.test/${n}/${end}` });
        link.style.cssText = `position: absolute; ${side}: 0; left: 0; width: 4px; height: 2px; overflow: hidden`;
        link.textContent = ".";
        return link;
      };
      const holder = element.tagName === "TR" ? element.firstElementChild : element;
      holder.style.position = "relative";
      holder.append(at("begin", "top"), at("end", "bottom"));
    });
    return whole.map(({ tagName, className }) => `${tagName} ${className}`);
  });

/** The links on each page of a PDF, whose objects Chromium writes uncompressed. */
function marksByPage(pdf) {
  const text = pdf.toString("latin1");
  const objects = new Map(
    [...text.matchAll(/(?:^|\n)(\d+) 0 obj\r?\n([\s\S]*?)\r?\nendobj/g)].map(([, number, body]) => [
      number,
      body,
    ]),
  );
  const inlined = (body, depth = 0) =>
    depth > 3
      ? body
      : body.replaceAll(/(\d+) 0 R/g, (all, number) => {
          const other = objects.get(number) ?? "";
          return /\/Subtype \/Link|\/S \/URI|^\s*\[/.test(other) ? inlined(other, depth + 1) : all;
        });
  return [...objects.values()]
    .filter((body) => /\/Type \/Page\b(?!s)/.test(body))
    .map((body) => {
      const annotations = /\/Annots (\[[\s\S]*?\]|\d+ 0 R)/.exec(body)?.[1] ?? "";
      return [...inlined(annotations).matchAll(/marks\.test\/(\d+)\/(begin|end)/g)].map(
        ([, n, end]) => `${n}/${end}`,
      );
    });
}

export const CHECKS = {
  "the report's form is filled and printed without splitting plots": async (name) => {
    const opened = await open(`v1/assets/${asset}/report`);
    const { page } = opened;
    const filled = {
      prepared_for: "Mill “North” & Sons",
      prepared_by: "A. Analyst",
    };
    await page.getByText("Complete this report before you print or send it").click();
    for (const [field, words] of Object.entries(filled)) await page.locator(`[name="${field}"]`).fill(words);
    await page
      .locator('[name="recommendation"]')
      .fill("Change the gears within two weeks.\nThen inspect the flanks.");
    await page.locator('[name="records"]').selectOption("true");
    // The run ends far above the warning limit.
    await page.locator(".verdict", { hasText: /^(Warning|Danger): wear depth/ }).waitFor();
    await page.getByText("All times are in UTC.").waitFor();
    for (const indicator of ["FM0", "FM4", "NA4"])
      await page.getByLabel(indicator, { exact: true }).uncheck();
    assert.ok(await page.getByLabel("Velocity RMS", { exact: true }).isChecked());
    await page.locator(".form button").click();
    await page.locator(".recommendation", { hasText: "Then inspect the flanks." }).waitFor();
    await page.locator(".signature", { hasText: "A. Analyst" }).waitFor();
    await page.getByText("Mill “North” & Sons").first().waitFor();
    const headings = await page.locator("section h2").allTextContents();
    assert.ok(headings.includes("Velocity RMS") && headings.includes("Kurtosis"), `${headings}`);
    assert.ok(!headings.some((heading) => ["FM0", "FM4", "NA4"].includes(heading)), `${headings}`);
    const marked = await mark(page);
    const figures = marked.filter((kind) => kind.startsWith("FIGURE"));
    assert.ok(figures.length >= 4, `${figures.length} figures`);
    const pdf = await page.pdf({ preferCSSPageSize: true, printBackground: true });
    if (shots) await writeFile(join(shots, "report.pdf"), pdf);
    const pages = marksByPage(pdf);
    assert.ok(pages.length >= 2, `${pages.length} pages`);
    const pageOf = (word) => pages.findIndex((marks) => marks.includes(word));
    marked.forEach((kind, n) => {
      const [begin, end] = [pageOf(`${n}/begin`), pageOf(`${n}/end`)];
      assert.ok(begin >= 0 && end === begin, `${kind} (${n}) is on page ${begin + 1} and ends on ${end + 1}`);
    });
    // not one plot per half-empty page
    assert.ok(pages.length <= figures.length + 3, `${pages.length} pages for ${figures.length} plots`);
    await page.emulateMedia({ media: "print" });
    assert.ok(await page.locator(".form").isHidden(), "the form is not printed");
    await close(opened, name);
  },

  "plots are readable on a phone": async (name) => {
    const opened = await open(`v1/assets/${asset}/report`, { ...PHONE, colorScheme: "light" });
    const { page } = opened;
    await noSidewaysScrolling(page);
    const plots = await page.locator("figure").evaluateAll((figures) =>
      figures.map((figure) => {
        const shown = [...figure.querySelectorAll(":scope > svg")].filter((svg) => svg.checkVisibility());
        const frame = figure.getBoundingClientRect();
        const labels = [...shown[0].querySelectorAll("text")].map((text) => text.getBoundingClientRect());
        const along = labels.slice(0, -2).filter(({ width, height }) => width > height);
        return {
          shown: shown.length,
          least: Math.min(...along.map(({ height }) => height)),
          outside: labels.filter(({ left, right }) => left < frame.left - 1 || right > frame.right + 1)
            .length,
          fits: figure.scrollWidth <= figure.clientWidth,
        };
      }),
    );
    assert.ok(plots.length >= 4, `${plots.length} plots`);
    for (const plot of plots) {
      assert.deepEqual([plot.shown, plot.outside, plot.fits], [1, 0, true], JSON.stringify(plot));
      assert.ok(plot.least >= 11, `text of ${plot.least} px`);
    }
    await close(opened, name);
  },
};
