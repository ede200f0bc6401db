// Keyboard alone, and axe-core on every page, light and dark.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { asset, close, drawn, json, open, overviewDrawn } from "./page.mjs";

const axe = await readFile(new URL("./node_modules/axe-core/axe.min.js", import.meta.url), "utf8");

const PAGES = {
  fleet: ["", (page) => page.locator(`[data-asset="${asset}"]`).waitFor()],
  asset: [`#/assets/${asset}?show=waveform,spectrum,envelope,turn,cepstrum,posterior&cursor=h~400`, (page) => drawn(page, "turn")],
  waterfall: [`#/assets/${asset}/waterfall`, (page) => drawn(page, "waterfall")],
  match: [`#/assets/${asset}/match`, (page) => drawn(page, "transmission")],
  settings: [`#/assets/${asset}/settings`, (page) => page.locator(".gear-drawing svg").waitFor()],
  alarms: [async () => `#/alarms?show=all&alarm=${(await json(`alarms?asset=${asset}`)).items[0].id}`, (page) => page.locator(".alarm-history li").first().waitFor()],
  "no alarm chosen": ["#/alarms", (page) => page.locator(".table-card .alarms, .table-card .notice").first().waitFor()],
  library: [async () => `#/libraries/${(await json("libraries")).items[0].id}`, (page) => drawn(page, "transmission")],
  report: [`v1/assets/${asset}/report`, (page) => page.locator("table tbody tr").first().waitFor()],
  "no such page": ["#/nowhere", (page) => page.getByText("This address leads nowhere").waitFor()],
  libraries: ["#/libraries", (page) => page.locator("tbody tr").first().waitFor()],
};

/** Serious and critical findings, each with the first places it was found at. */
async function findings(page) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map(({ html, failureSummary }) => `${html.slice(0, 160)} ${failureSummary.slice(0, 160)}`).join(" | ")}`);
}

const checks = Object.entries(PAGES).map(([key, [address, ready]]) => [
  `axe finds nothing serious on the page: ${key}`,
  async () => {
    for (const colorScheme of ["light", "dark"]) {
      const { page } = await open(typeof address === "string" ? address : await address(), { colorScheme });
      await ready(page);
      await page.waitForTimeout(500);
      assert.deepEqual(await findings(page), [], `${key}, ${colorScheme}`);
      await page.context().close();
    }
  },
]);

/** What has the keyboard: its accessible words. */
const focused = (page) => page.evaluate(() => (document.activeElement.getAttribute("aria-label") ?? document.activeElement.textContent ?? "").trim().slice(0, 60));

export const CHECKS = {
  ...Object.fromEntries(checks),

  "axe finds nothing serious in the dialog for records": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await page.getByRole("button", { name: "Add records" }).click();
    assert.deepEqual(await findings(page), []);
    await page.context().close();
  },

  "axe finds nothing serious in the dialog for maintenance": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await page.getByRole("button", { name: "Enter maintenance" }).click();
    assert.deepEqual(await findings(page), []);
    await page.context().close();
  },

  "the keyboard alone leads from the fleet to a record and back": async (name) => {
    const opened = await open("");
    const { page } = opened;
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    await page.keyboard.press("Tab");
    assert.equal(await focused(page), "Skip to content");
    const { name: title } = await json(`assets/${asset}`);
    for (let presses = 0; (await focused(page)) !== (title || asset); presses++) {
      assert.ok(presses < 60, "the asset's link is reached");
      await page.keyboard.press("Tab");
    }
    await page.keyboard.press("Enter");
    await overviewDrawn(page);
    for (let presses = 0; !(await focused(page)).includes("Previous"); presses++) {
      assert.ok(presses < 90, "the buttons of the record are reached");
      await page.keyboard.press("Tab");
    }
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => location.hash.includes("segment="));
    await page.goBack();
    await page.waitForFunction(() => !location.hash.includes("segment="));
    await close(opened, name);
  },
};
