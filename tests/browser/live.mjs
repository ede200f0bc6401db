// New records show up by themselves; a lost connection is shown and recovers.

import assert from "node:assert/strict";
import { asset, base, drawn, json, open } from "./page.mjs";

/** Sends a record of noise to an asset. */
async function send(id, minute) {
  const samples = Array.from({ length: 2000 }, (_, n) => Math.sin(n * 0.49) + 0.2 * Math.sin(n * n));
  const body = JSON.stringify({ start_time: `2026-03-01T08:${String(minute).padStart(2, "0")}:00Z`, sample_rate_hz: 4000, unit: "m/s2", channel: "a1", samples });
  const answer = await fetch(`${base}/v1/assets/${id}/segments`, { method: "POST", headers: { "content-type": "application/json" }, body });
  assert.equal(answer.status, 201, await answer.text());
}

export const CHECKS = {
  "a new asset and its records appear without a reload": async () => {
    const id = `live-${Date.now()}`;
    const { page, faults } = await open("");
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    const spec = { id, gear: { teeth: [31, 62], shaft_speed_hz: 10 }, baseline: { records: 8 } };
    await fetch(`${base}/v1/assets`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(spec) });
    const row = page.locator(`[data-asset="${id}"]`);
    await row.waitFor({ timeout: 25_000 });
    await row.getByText("No records").first().waitFor();
    await row.getByRole("link").click();
    await page.getByText("Waiting for the first record").waitFor();
    await send(id, 0);
    await drawn(page, "trends");
    await send(id, 1);
    await page.getByText("2 records").waitFor({ timeout: 25_000 });
    assert.deepEqual(faults, []);
    await page.context().close();
    await fetch(`${base}/v1/assets/${id}`, { method: "DELETE" });
  },

  "without a stream of events the page asks again by itself": async () => {
    const id = `polled-${Date.now()}`;
    const { page } = await open("", {}, (fresh) => fresh.route("**/v1/events*", (route) => route.abort()));
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    await fetch(`${base}/v1/assets`, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ id, gear: { teeth: [31, 62], shaft_speed_hz: 10 } }) });
    await page.locator(`[data-asset="${id}"]`).waitFor({ timeout: 10_000 });
    assert.ok(await page.locator("#banner").isHidden(), "polling is no loss of the connection");
    await page.context().close();
    await fetch(`${base}/v1/assets/${id}`, { method: "DELETE" });
  },

  "an unknown asset is told apart from a lost connection": async () => {
    for (const view of ["", "/waterfall", "/match", "/settings"]) {
      const { page } = await open(`#/assets/no-such-asset${view}`);
      await page.getByText("There is no asset “no-such-asset”").waitFor();
      assert.ok(await page.locator("#banner").isHidden());
      await page.context().close();
    }
  },

  "a lost connection is shown and recovers": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await drawn(page, "wear");
    await page.context().setOffline(true);
    await page.route("**/v1/**", (route) => route.abort());
    await page.evaluate(() => document.dispatchEvent(new CustomEvent("recordschange")));
    await page.getByText("Connection lost since").waitFor();
    assert.ok(await page.locator('[data-plot="wear"] .plot').isVisible(), "what was there stays");
    await page.unroute("**/v1/**");
    await page.context().setOffline(false);
    // the browser says that it is online again, which is reason enough to ask
    await page.locator("#banner").waitFor({ state: "hidden" });
    assert.ok((await json("assets")).items.length > 0);
    await page.context().close();
  },
};
