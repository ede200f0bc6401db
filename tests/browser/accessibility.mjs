// Keyboard operation, and axe-core on every page, light and dark.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import {
  asset,
  close,
  createAsset,
  drawn,
  json,
  MAIN_PAGES,
  open,
  overviewDrawn,
  PHONE,
  removeAsset,
} from "./page.mjs";

const axe = await readFile(new URL("./node_modules/axe-core/axe.min.js", import.meta.url), "utf8");

const PAGES = {
  ...MAIN_PAGES,
  asset: [
    `#/assets/${asset}?show=waveform,spectrum,envelope,turn,cepstrum,posterior&cursor=h~400`,
    (page) => drawn(page, "turn"),
  ],
  "alarm levels": [`#/assets/${asset}?trend=rms&levels=rms`, (page) => drawn(page, "trends")],
  "new asset": [
    "#/new",
    async (page) => {
      await page.getByLabel("Gear pair, for wear in µm").selectOption("shen2022");
      await drawn(page, "preview-spectrum");
    },
  ],
  "what wear does": [`#/assets/${asset}/wear`, (page) => drawn(page, "preview-spectrum")],
  "no alarm chosen": [
    "#/alarms",
    (page) => page.locator(".table-card .alarms, .table-card .notice").first().waitFor(),
  ],
  report: [`v1/assets/${asset}/report`, (page) => page.locator("table tbody tr").first().waitFor()],
  "two records": [
    async () =>
      `#/assets/${asset}?pin=${(await json(`assets/${asset}/segments?limit=3`)).items[2].id}&log=1&bins=speed`,
    (page) => page.locator('[data-plot="envelope"] .legend', { hasText: "pinned record" }).waitFor(),
  ],
  bench: [
    async () => {
      const { items } = await json(`assets/${asset}/segments?limit=3`);
      const ids = items.map(({ id }) => id).join(",");
      return `#/bench?records=${ids}&show=waveform,spectrum,envelope,turn,cepstrum&cursor=h~400&ecursor=b&bearing=g~9~7.94~39.04~0&quantity=velocity`;
    },
    (page) => drawn(page, "turn"),
  ],
  "empty bench": ["#/bench", (page) => page.getByText("No records on the bench yet").waitFor()],
  "no such asset": ["#/assets/no-such-asset", (page) => page.getByText("not found on this server").waitFor()],
  "no such page": ["#/nowhere", (page) => page.getByText("There is no page at this address").waitFor()],
};

/** Serious and critical findings, each with the first places where it was found. */
export async function findings(page) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() =>
    globalThis.axe.run(document, { resultTypes: ["violations"] }),
  );
  return violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .map(
      ({ id, nodes }) =>
        `${id}: ${nodes
          .slice(0, 3)
          .map(({ html, failureSummary }) => `${html.slice(0, 160)} ${failureSummary.slice(0, 160)}`)
          .join(" | ")}`,
    );
}

const checks = Object.entries(PAGES).map(([key, [address, ready]]) => [
  `axe finds nothing serious on the page: ${key}`,
  async () => {
    const { page } = await open(address, {
      colorScheme: "light",
    });
    await ready(page);
    for (const colorScheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme });
      await page.waitForTimeout(500);
      assert.deepEqual(await findings(page), [], `${key}, ${colorScheme}`);
    }
    await page.context().close();
  },
]);

/** The accessible text of the focused element. */
const focused = (page) =>
  page.evaluate(() =>
    (document.activeElement.getAttribute("aria-label") ?? document.activeElement.textContent ?? "")
      .trim()
      .slice(0, 60),
  );

export const CHECKS = {
  ...Object.fromEntries(checks),

  "axe finds no serious issue in the dialogs, with a rejected file": async () => {
    for (const colorScheme of ["light", "dark"]) {
      const { page } = await open(`#/assets/${asset}`, { colorScheme });
      await page.getByRole("button", { name: "Add records" }).click();
      await page.setInputFiles("#upload-file", {
        name: "broken.wav",
        mimeType: "audio/wav",
        buffer: Buffer.from("not a recording"),
      });
      await page.getByLabel("Start of broken.wav, UTC").waitFor();
      assert.deepEqual(await findings(page), [], `files to send, ${colorScheme}`);
      await page.getByRole("button", { name: "Upload file" }).click();
      await page.locator('.results .result[data-kind="bad"]').waitFor();
      assert.deepEqual(await findings(page), [], `records, ${colorScheme}`);
      await page.keyboard.press("Escape");
      await page.getByRole("button", { name: "Add maintenance" }).click();
      assert.deepEqual(await findings(page), [], `maintenance, ${colorScheme}`);
      await page.getByLabel("Wear measured").check();
      await page.getByLabel("Standard error (µm)").fill("0");
      await page.getByLabel("Measured depth (µm)").focus();
      await page.getByText("Enter a number above 0").waitFor();
      assert.deepEqual(await findings(page), [], `inspection, ${colorScheme}`);
      await page.context().close();
    }
  },

  "axe finds no serious issue on empty pages, offline, and in the token dialog": async () => {
    const empty = JSON.stringify({ items: [], next_cursor: null });
    const answered = (status, body) => (page) =>
      page.route(/\/v1\/assets\?/, (route) =>
        route.fulfill({ status, contentType: "application/json", body }),
      );
    const id = await createAsset("waiting", {});
    for (const colorScheme of ["light", "dark"]) {
      const states = [
        ["first steps", "", answered(200, empty), "No assets yet"],
        ["waiting for a record", `#/assets/${id}`, async () => {}, "Waiting for the first record"],
        ["no record to match", `#/assets/${id}/match`, async () => {}, "No records yet"],
        [
          "connection lost",
          "",
          (page) => page.route("**/v1/**", (route) => route.abort()),
          "Connection lost since",
        ],
        ["token wanted", "", answered(401, JSON.stringify({ title: "a token is needed" })), "Token required"],
      ];
      for (const [state, address, before, words] of states) {
        const { page } = await open(address, { colorScheme }, before);
        await page.getByText(words).first().waitFor();
        assert.deepEqual(await findings(page), [], `${state}, ${colorScheme}`);
        await page.context().close();
      }
    }
    await removeAsset(id);
  },

  "axe finds no serious issue on a phone": async () => {
    for (const key of ["fleet", "asset", "alarms", "match"]) {
      const [address, ready] = PAGES[key];
      const { page } = await open(address, PHONE);
      await ready(page);
      assert.deepEqual(await findings(page), [], key);
      await page.context().close();
    }
  },

  "a record is reached from the fleet and left again by keyboard": async (name) => {
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
