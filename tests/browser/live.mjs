// New records appear automatically; a lost connection is reported and recovers.

import assert from "node:assert/strict";
import { asset, createAsset, drawn, json, open, removeAsset, sendNoise } from "./page.mjs";

export const CHECKS = {
  "a new asset and its records appear without a reload": async () => {
    const { page, faults } = await open("");
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    const id = await createAsset("live", { baseline: { records: 8 } });
    const row = page.locator(`[data-asset="${id}"]`);
    await row.waitFor();
    await row.getByText("No records").first().waitFor();
    await row.getByRole("link").click();
    await page.getByRole("heading", { name: "Waiting for the first record" }).waitFor();
    await sendNoise(id, 0);
    await drawn(page, "trends");
    await sendNoise(id, 1);
    await page.getByText("2 records").waitFor();
    assert.deepEqual(faults, []);
    await page.context().close();
    await removeAsset(id);
  },

  "continuously arriving records do not stall the page": async () => {
    const id = await createAsset("busy", {});
    const { page } = await open(`#/assets/${id}`);
    await page.getByRole("heading", { name: "Waiting for the first record" }).waitFor();
    let sending = true;
    const stream = (async () => {
      for (let minute = 0; sending && minute < 60; minute++) {
        await sendNoise(id, minute);
        await new Promise((resolve) => setTimeout(resolve, 100));
      }
    })();
    await page.getByText(/^[1-9]\d* records?/).waitFor();
    assert.ok(
      (await json(`assets/${id}`)).summary.segments < 60,
      "the page followed while records were coming",
    );
    sending = false;
    await stream;
    await page.context().close();
    await removeAsset(id);
  },

  "without an event stream the page polls": async () => {
    const { page } = await open("", {}, (fresh) => fresh.route("**/v1/events*", (route) => route.abort()));
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    const id = await createAsset("polled", {});
    await page.locator(`[data-asset="${id}"]`).waitFor();
    assert.ok(await page.locator("#banner").isHidden(), "polling is no loss of the connection");
    await page.context().close();
    await removeAsset(id);
  },

  "an unknown asset is distinguished from a lost connection": async () => {
    for (const view of ["", "/waterfall", "/match", "/settings"]) {
      const { page } = await open(`#/assets/no-such-asset${view}`);
      await page.getByText("Asset “no-such-asset” not found on this server").waitFor();
      assert.ok(await page.locator("#banner").isHidden());
      await page.context().close();
    }
  },

  "a lost connection is reported and recovers": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await drawn(page, "wear");
    await page.context().setOffline(true);
    await page.route("**/v1/**", (route) => route.abort());
    await page.evaluate(() => document.dispatchEvent(new CustomEvent("recordschange")));
    await page.getByText("Connection lost since").waitFor();
    assert.ok(await page.locator('[data-plot="wear"] .plot').isVisible(), "what was there stays");
    await page.unroute("**/v1/**");
    await page.context().setOffline(false);
    // the browser's `online` event triggers an update
    await page.locator("#banner").waitFor({ state: "hidden" });
    assert.ok((await json("assets")).items.length > 0);
    await page.context().close();
  },
};
