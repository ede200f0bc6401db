// Keyboard focus on each page: every control is reached once, visible, named and marked.

import assert from "node:assert/strict";
import { asset, close, drawn, MAIN_PAGES, open, overviewDrawn } from "./page.mjs";

const PAGES = {
  ...MAIN_PAGES,
  asset: [
    `#/assets/${asset}?show=waveform,spectrum,envelope,turn,cepstrum,posterior&cursor=s~399.36~16.64&zoom=1`,
    async (page) => (await overviewDrawn(page), await drawn(page, "turn")),
  ],
};

const MOST = 400;

/** The focused element: its name, position and focus mark; each element is numbered when first seen. */
const focused = (page) =>
  page.evaluate(() => {
    const element = document.activeElement;
    if (element === document.body) return null;
    globalThis.walked ??= new Map();
    if (!walked.has(element)) walked.set(element, walked.size);
    const { left, top, width, height } = element.getBoundingClientRect();
    const [x, y] = [left + width / 2, top + height / 2];
    const hit = document.elementFromPoint(x, y);
    const label = element.labels?.[0]?.textContent;
    const name =
      (element.getAttribute("aria-label") ?? label ?? element.textContent ?? "").trim() ||
      (element.getAttribute("title") ?? "");
    const { outlineStyle, outlineWidth } = getComputedStyle(element);
    const inView = x >= 0 && y >= 0 && x <= innerWidth && (y <= innerHeight || height > innerHeight);
    return {
      number: walked.get(element),
      name,
      html: element.outerHTML.slice(0, 120),
      marked: outlineStyle !== "none" && parseFloat(outlineWidth) >= 1,
      inView,
      uncovered:
        height > innerHeight / 2 ||
        Boolean(
          hit && (element.contains(hit) || hit.contains(element) || element.labels?.[0]?.contains(hit)),
        ),
    };
  });

/** Controls that were not reached; radio buttons and hidden parts are only partly expected. */
const missed = (page) =>
  page.evaluate(() =>
    [
      ...document.querySelectorAll(
        "a[href], button:not(:disabled), select:not(:disabled), input:not(:disabled), textarea, [tabindex='0']",
      ),
    ]
      .filter(
        (element) =>
          element.checkVisibility({ visibilityProperty: true }) &&
          element.type !== "radio" &&
          element.tabIndex >= 0 &&
          !walked.has(element),
      )
      .map((element) => element.outerHTML.slice(0, 120)),
  );

async function walk(page) {
  const seen = new Set();
  let last;
  for (let presses = 0; presses < MOST; presses++) {
    await page.keyboard.press("Tab");
    const at = await focused(page);
    if (at !== null && at.number === last) continue; // a field of date and time is walked through part by part
    if (at === null || seen.has(at.number)) break; // past the last, or around
    last = at.number;
    seen.add(at.number);
    assert.ok(at.name, `without a name: ${at.html}`);
    assert.ok(at.marked, `the focus is not to be seen: ${at.html}`);
    assert.ok(at.inView, `out of view: ${at.html}`);
    assert.ok(at.uncovered, `covered by something else: ${at.html}`);
  }
  assert.ok(seen.size < MOST, "the walk comes to an end");
  assert.deepEqual(await missed(page), [], "nothing is left out");
  return seen.size;
}

const checks = Object.entries(PAGES).map(([key, [address, ready]]) => [
  `the keyboard reaches everything on the page: ${key}`,
  async (name) => {
    const opened = await open(address);
    await ready(opened.page);
    await opened.page.waitForTimeout(500);
    console.log(`        ${await walk(opened.page)} stops`);
    await close(opened, name);
  },
]);

export const CHECKS = {
  ...Object.fromEntries(checks),

  "dialogs are opened, used and closed by keyboard, and return the focus": async () => {
    const { page, faults } = await open(`#/assets/${asset}`);
    await overviewDrawn(page);
    for (const [button, dialog] of [
      ["Add records…", `Add records to ${asset}`],
      ["Add maintenance…", `Maintenance of ${asset}`],
    ]) {
      await page.getByRole("button", { name: button }).focus();
      await page.keyboard.press("Enter");
      await page.getByRole("dialog", { name: dialog }).waitFor();
      const inside = await page.evaluate(() =>
        document.querySelector("dialog[open]").contains(document.activeElement),
      );
      assert.ok(inside, "the focus is in the dialog");
      for (let presses = 0; presses < 20; presses++) {
        await page.keyboard.press("Tab");
        const where = await page.evaluate(
          () =>
            document.activeElement === document.body ||
            document.querySelector("dialog[open]").contains(document.activeElement),
        );
        assert.ok(where, "the page under the dialog is not reached");
      }
      await page.keyboard.press("Escape");
      await page.getByRole("dialog", { name: dialog }).waitFor({ state: "hidden" });
      assert.equal(await page.evaluate(() => document.activeElement.textContent), button);
    }
    assert.deepEqual(faults, []);
    await page.context().close();
  },
};
