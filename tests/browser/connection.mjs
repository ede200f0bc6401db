// The page while the server is unavailable, simulated by a proxy that can be closed.

import assert from "node:assert/strict";
import { createServer, request } from "node:http";
import { asset, base, createAsset, drawn, newContext, removeAsset, sendNoise } from "./page.mjs";

/**
 * Forwards requests to the server; `streams` says whether the event stream is forwarded, `close()` and
 * `open()` affect all requests, `hold()` those to come.
 */
async function gate() {
  const target = new URL(base);
  const streams = new Set();
  const state = { streams: true, held: false, port: 0 };
  const server = createServer((incoming, outgoing) => {
    const isStream = incoming.url.startsWith("/v1/events");
    if (isStream && !state.streams) return outgoing.writeHead(404).end();
    if (isStream) streams.add(outgoing);
    if (state.held) return;
    const { hostname: host, port } = target;
    const passed = request(
      { host, port, path: incoming.url, method: incoming.method, headers: incoming.headers },
      (answer) => {
        outgoing.writeHead(answer.statusCode, answer.headers);
        answer.pipe(outgoing);
      },
    );
    passed.on("error", () => outgoing.destroy());
    outgoing.on("close", () => passed.destroy());
    incoming.pipe(passed);
  });
  const listen = () => new Promise((resolve) => server.listen(state.port, "127.0.0.1", resolve));
  await listen();
  state.port = server.address().port;
  return {
    url: `http://127.0.0.1:${state.port}`,
    stopStreams: () => {
      state.streams = false;
      for (const stream of streams) stream.destroy();
    },
    hold: () => (state.held = true),
    close: () => {
      server.close();
      server.closeAllConnections();
    },
    open: async () => {
      state.streams = true;
      await listen();
    },
  };
}

const told = (page, words) => page.locator(`#live[title*="${words}"]`).waitFor();
const PUSHED = "Live updates from the server";
const POLLED = "Polling the server";

export const CHECKS = {
  "polling replaces a lost event stream, and the server goes away and comes back": async () => {
    const passage = await gate();
    const id = await createAsset("gated", {});
    await sendNoise(id, 0);
    const context = await newContext({ viewport: { width: 1280, height: 900 } });
    const page = await context.newPage();
    const exceptions = [];
    page.on("pageerror", (error) => exceptions.push(error.stack));
    await page.goto(`${passage.url}/#/assets/${id}?trend=rms`);
    await drawn(page, "trends");
    await told(page, PUSHED);

    passage.stopStreams();
    await told(page, POLLED);
    await sendNoise(id, 1);
    await page.getByText("2 records").waitFor();
    assert.ok(await page.locator("#banner").isHidden(), "polling is no loss");

    passage.close();
    await page.getByText("Connection lost since").waitFor();
    assert.equal(await page.locator("#live").getAttribute("data-state"), "lost");
    await page.locator("#banner-wait", { hasText: /Retrying/ }).waitFor();
    assert.ok(await page.locator('[data-plot="trends"] .plot').isVisible(), "what was there stays");
    await sendNoise(id, 2);

    await passage.open();
    await page.locator("#banner").waitFor({ state: "hidden" });
    await page.getByText("3 records").waitFor();
    assert.equal(await page.locator("#live").getAttribute("data-state"), "live");
    await told(page, PUSHED);
    await sendNoise(id, 3);
    await page.getByText("4 records").waitFor();
    assert.deepEqual(exceptions, []);
    await context.close();
    passage.close();
    await removeAsset(id);
  },

  "a server that does not answer is no live connection": async () => {
    const passage = await gate();
    const context = await newContext({ viewport: { width: 1280, height: 900 } });
    const page = await context.newPage();
    await page.clock.install();
    await page.goto(`${passage.url}/`);
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    await page.locator('#live[data-state="live"]').waitFor();
    passage.hold();
    await page.clock.fastForward(21_000); // until the next request
    await page.clock.fastForward(61_000);
    await page.getByText(/Connection lost since .*: no answer so far\. The data shown/).waitFor();
    assert.equal(await page.locator("#live").getAttribute("data-state"), "lost");
    await context.close();
    passage.close();
  },

  "a page opened while the server is unavailable loads when it is back": async () => {
    const passage = await gate();
    const context = await newContext({ viewport: { width: 1280, height: 900 } });
    const page = await context.newPage();
    await page.goto(`${passage.url}/`);
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    await page.getByRole("link", { name: "Alarms" }).first().click();
    await page.locator(".table-card .alarms, .table-card .notice").first().waitFor();
    passage.close();
    await page.goBack();
    await page.getByText("Connection lost since").waitFor();
    await page.getByRole("button", { name: "Retry now" }).waitFor();
    await passage.open();
    await page.getByRole("button", { name: "Retry now" }).click();
    await page.locator("#banner").waitFor({ state: "hidden" });
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    await context.close();
    passage.close();
  },

  "a page whose code cannot be loaded says so and loads when the server is back": async () => {
    const passage = await gate();
    const context = await newContext({ viewport: { width: 1280, height: 900 } });
    const page = await context.newPage();
    await page.goto(`${passage.url}/`);
    await page.locator(`[data-asset="${asset}"]`).waitFor();
    passage.close();
    await page.getByRole("link", { name: "Libraries" }).click();
    await page.getByText("This page could not be loaded from the server").waitFor();
    await page.getByText("Connection lost since").waitFor();
    await passage.open();
    await page.locator("h1", { hasText: "Libraries" }).waitFor();
    await page.locator("tbody tr").first().waitFor();
    await context.close();
    passage.close();
  },
};
