// The live view of a stream: it updates while samples arrive, freezes, and saves records.

import assert from "node:assert/strict";
import { findings } from "./accessibility.mjs";
import {
  base,
  close,
  createAsset,
  drawn,
  json,
  noSidewaysScrolling,
  open,
  PHONE,
  removeAsset,
  shoot,
} from "./page.mjs";

const RATE = 8000;
const TONE = 930; // the third mesh harmonic of the asset
const AMPLITUDE = 2;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Samples of two channels between two indices. */
function samples(from, to) {
  const values = new Float32Array(2 * (to - from));
  for (let k = from; k < to; k++) {
    const value = AMPLITUDE * Math.sin((2 * Math.PI * TONE * k) / RATE) + 0.3 * (Math.random() - 0.5);
    values.set([value, value / 2], 2 * (k - from));
  }
  return values;
}

/** Sends a stream in real time until it is stopped. */
export async function sensor(id) {
  const query = `sample=f32&sample_rate_hz=${RATE}&channels=2&channel_names=in,out&unit=m/s2`;
  const began = Date.now();
  let [sent, sending] = [0, true];
  const send = async () => {
    const due = Math.max(sent + 8, Math.floor(((Date.now() - began) / 1000) * RATE));
    const time = new Date(began + (1000 * sent) / RATE).toISOString();
    const answer = await fetch(
      `${base}/v1/assets/${id}/stream?${query}&first_index=${sent}&start_time=${time}`,
      { method: "POST", headers: { "content-type": "application/octet-stream" }, body: samples(sent, due) },
    );
    assert.equal(answer.status, 200, await answer.text());
    sent = due;
  };
  await send();
  const loop = (async () => {
    while (sending) {
      await pause(30);
      if (sending) await send();
    }
  })();
  return () => {
    sending = false;
    return loop;
  };
}

const frames = (page) => page.locator(".stream-page").evaluate((body) => Number(body.dataset.frames ?? 0));
const numberOf = async (page, key) =>
  Number.parseFloat(await page.locator(`.stream-values [data-value="${key}"]`).innerText());

/** The last spectrum line, which is the stream's. */
const spectrumLine = (page) =>
  page.evaluate(() => {
    /** @type {any} */
    const plot = document.querySelector('[data-plot="live-spectrum"] .plot');
    const { x, y } = plot.data.at(-1);
    return { x: Array.from(x), y: Array.from(y), lines: plot.data.length };
  });

const highest = ({ x, y }) => x[y.indexOf(Math.max(...y))];

/** Runs a check with an asset that receives a stream. */
async function withStream(kind, check) {
  const id = await createAsset(kind, { stream: { record_s: 1, interval_s: 2 } });
  const stop = await sensor(id);
  try {
    await check(id, stop);
  } finally {
    await stop();
    await removeAsset(id);
  }
}

export const CHECKS = {
  "a stream is shown live, in hertz and in orders, until it is frozen": (name) =>
    withStream("stream", async (id) => {
      const opened = await open(`#/assets/${id}`);
      const { page } = opened;
      await page.getByRole("link", { name: "Live", exact: true }).click();
      await drawn(page, "scope");
      await drawn(page, "live-spectrum");
      await pause(1500);
      const [before, began] = [await frames(page), Date.now()];
      await pause(3000);
      const rate = (1000 * ((await frames(page)) - before)) / (Date.now() - began);
      console.log(`        ${rate.toFixed(1)} updates a second`);
      assert.ok(rate >= 5, `${rate} updates a second`);
      assert.ok(Math.abs(highest(await spectrumLine(page)) - TONE) <= 1);
      assert.ok(Math.abs((await numberOf(page, "rms")) - AMPLITUDE / Math.SQRT2) < 0.05);
      assert.equal(await page.locator('.stream-values [data-value="mesh"]').innerText(), "310 Hz");
      for (const colorScheme of /** @type {const} */ (["dark", "light"])) {
        await page.emulateMedia({ colorScheme });
        assert.deepEqual(await findings(page), [], colorScheme);
        await shoot(page, `live view ${colorScheme}`);
      }
      await page.locator("#stream-axis").selectOption("orders");
      await page.locator("#stream-channel").selectOption("out");
      await page.waitForFunction(() =>
        document.querySelector('[data-plot="live-spectrum"] .xtitle')?.textContent.startsWith("Order"),
      );
      assert.ok(Math.abs(highest(await spectrumLine(page)) - TONE / 10) <= 0.1);
      assert.match(page.url(), /axis=orders/);
      assert.match(page.url(), /channel=out/);
      await page.getByRole("button", { name: "Freeze" }).click();
      await page.getByText("Frozen at").waitFor();
      await pause(300);
      const held = await frames(page);
      await pause(700);
      assert.equal(await frames(page), held, "what is frozen stays");
      await page.getByRole("button", { name: "Resume" }).click();
      await page.waitForFunction(
        (held) =>
          Number(/** @type {HTMLElement} */ (document.querySelector(".stream-page")).dataset.frames) >
          held + 3,
        held,
      );
      await noSidewaysScrolling(page);
      await close(opened, name);
    }),

  "the displayed samples are saved as a record and compared with the last one": (name) =>
    withStream("keep", async (id) => {
      const opened = await open(`#/assets/${id}/live?keep=5&compare=1`, PHONE);
      const { page } = opened;
      await drawn(page, "live-spectrum");
      await page.locator('[data-plot="live-spectrum"] .legend', { hasText: "record of" }).waitFor();
      assert.equal((await spectrumLine(page)).lines, 2);
      await noSidewaysScrolling(page);
      assert.deepEqual(await findings(page), []);
      await shoot(page, "live view on a phone");
      await page.getByRole("button", { name: "Save as record" }).click();
      const link = page.getByRole("link", { name: "Open record" });
      await link.waitFor();
      const segment = new URLSearchParams((await link.getAttribute("href")).split("?")[1]).get("segment");
      const { asset_id: owner, samples, channel } = await json(`segments/${segment}`);
      assert.deepEqual([owner, channel], [id, "in"]);
      assert.ok(samples > RATE && samples <= 5 * RATE, `${samples} samples`);
      await close(opened, name);
    }),

  "a stalled stream is reported, and an asset without streams has no live page": (name) =>
    withStream("still", async (id, stop) => {
      const opened = await open(`#/assets/${id}/live`);
      const { page } = opened;
      await drawn(page, "scope");
      await stop();
      await page.getByText(/^No samples for ([3-9]|\d\d+) s$/).waitFor();
      await close(opened, name);
      const none = await createAsset("silent", {});
      const other = await open(`#/assets/${none}`);
      await other.page.getByText("Waiting for the first record").waitFor();
      assert.ok(await other.page.getByRole("link", { name: "Live", exact: true }).isHidden());
      await other.page.goto(`${base}/#/assets/${none}/live`);
      await other.page.getByText("This asset has no live streams").first().waitFor();
      await close(other, `${name} none`);
      await removeAsset(none);
    }),
};
