// What is typed for a new asset stays after a reload and on the way back.

import assert from "node:assert/strict";
import { close, open, removeAsset } from "./page.mjs";
import { fill } from "./setup.mjs";

const TYPED = { "Teeth, driving": "24", "Teeth, driven": "26", "Driving shaft speed (rpm)": "998.4" };

/** Opens the form while the answer with the presets is held back; `arrive` lets it through. */
async function openBeforePresets() {
  let arrive;
  const arrived = new Promise((resolve) => (arrive = resolve));
  const { page } = await open("#/new", {}, (page) =>
    page.route("**/v1/pair-presets", async (route) => {
      await arrived;
      await route.continue().catch(() => {}); // that of a page before a reload
    }),
  );
  return {
    page,
    arrive: async () => {
      arrive();
      await page
        .locator("#setup-pair option", { hasText: "Start from:" })
        .first()
        .waitFor({ state: "attached" });
    },
  };
}

export const CHECKS = {
  "entries of a new asset survive a reload and the way back": async (name) => {
    const id = `draft-${Date.now()}`;
    const opened = await open("#/new");
    const { page } = opened;
    const value = (label) => page.getByLabel(label, { exact: true }).inputValue();
    const restored = page.getByText("These are your entries from before");
    await fill(page, { Name: id, ...TYPED });
    await page.getByRole("button", { name: "Add another bearing" }).click();
    await fill(page, { "Bearing 2": "fan_end", "Torque on the driving gear (N·m)": "5" });
    await page.reload();
    await restored.waitFor();
    assert.deepEqual(await Promise.all(["Id", ...Object.keys(TYPED), "Bearing 2"].map(value)), [
      id,
      ...Object.values(TYPED),
      "fan_end",
    ]);
    assert.equal(await value("Bore radius, driving (mm)"), "", "a default is not an entry");
    await page.getByRole("link", { name: "Alarms" }).click();
    await page.getByRole("heading", { name: "Alarms", exact: true }).waitFor();
    await page.goBack();
    await restored.waitFor();
    assert.equal(await value("Teeth, driven"), "26");
    // without the pair's data the way to an asset without one is named
    await page.getByRole("button", { name: "Create asset" }).click();
    await page
      .locator('.result[data-kind="bad"]', { hasText: "choose “None: indicators only” as the gear pair" })
      .waitFor();
    await page.getByLabel("Gear pair, for wear in µm").selectOption({ label: "None: indicators only" });
    await fill(page, { "Bearing 2": "" });
    await page.getByRole("button", { name: "Create asset" }).click();
    await page.getByRole("heading", { name: id }).first().waitFor();
    await page.goto(`${page.url().split("#")[0]}#/new`);
    await page.getByRole("heading", { name: "New asset" }).waitFor();
    assert.equal(await value("Teeth, driven"), "", "what was created is not offered again");
    await fill(page, TYPED);
    await page.reload();
    await restored.waitFor();
    await page.getByRole("button", { name: "Start over" }).click();
    assert.equal(await value("Teeth, driven"), "");
    await page.reload();
    await page.getByRole("heading", { name: "New asset" }).waitFor();
    assert.ok(await restored.isHidden());
    await close(opened, name);
    await removeAsset(id);
  },

  "entries made before the presets arrive stay, and are not taken for earlier ones": async () => {
    const { page, arrive } = await openBeforePresets();
    await fill(page, TYPED);
    await arrive();
    await fill(page, { "Module (mm)": "6" });
    assert.ok(await page.getByText("These are your entries from before").isHidden());
    assert.equal(await page.getByLabel("Teeth, driving", { exact: true }).inputValue(), "24");
    await page.context().close();
  },

  "errors shown before the presets arrive stay": async () => {
    const { page, arrive } = await openBeforePresets();
    await fill(page, TYPED);
    await page.reload();
    await page.getByText("These are your entries from before").waitFor();
    await page.getByRole("button", { name: "Create asset" }).click();
    const error = page.locator('.result[data-kind="bad"]', { hasText: "Still required" });
    await error.waitFor();
    await arrive();
    assert.ok(await error.isVisible());
    await page.context().close();
  },
};
