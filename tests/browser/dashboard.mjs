// The dashboard in a real browser, against a running server.
//
//   FLANKWATCH_URL       where it is served, for example http://127.0.0.1:8600
//   FLANKWATCH_ASSET     an asset with at least a few estimated records
//   FLANKWATCH_CHROMIUM  the browser (default /usr/bin/chromium)
//   FLANKWATCH_SHOTS     a folder for screenshots (none are taken where it is not set)

import assert from "node:assert/strict";
import { mkdir } from "node:fs/promises";
import { join } from "node:path";
import { chromium } from "playwright-core";

const base = required("FLANKWATCH_URL").replace(/\/$/, "");
const asset = required("FLANKWATCH_ASSET");
const shots = process.env.FLANKWATCH_SHOTS;
const PLOTS = ["wear", "trends", "spectrum", "envelope"];
const ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

function required(name) {
  const value = process.env[name];
  if (!value) throw new Error(`${name} is not set`);
  return value;
}

const browser = await chromium.launch({ executablePath: process.env.FLANKWATCH_CHROMIUM ?? "/usr/bin/chromium", args: ARGUMENTS });

/** A fresh page and the list of what went wrong in it: errors on the console, exceptions, requests to other hosts. */
async function open(path, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, ...options });
  const page = await context.newPage();
  const faults = [];
  page.on("console", (message) => message.type() === "error" && faults.push(`console: ${message.text()} ${message.location().url}`));
  page.on("pageerror", (error) => faults.push(`exception: ${error.stack}`));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (/^(https?|wss?):$/.test(url.protocol) && url.origin !== new URL(base).origin) faults.push(`outside host: ${url}`);
  });
  await page.goto(`${base}/${path}`);
  return { page, faults };
}

async function close({ page, faults }, name) {
  if (shots) await page.screenshot({ path: join(shots, `${name.replaceAll(/\W+/g, "-")}.png`), fullPage: true });
  assert.deepEqual(faults, [], "nothing goes wrong in the page");
  await page.context().close();
}

const drawn = (page, kind) => page.locator(`[data-plot="${kind}"] .plot .main-svg`).first().waitFor({ state: "visible", timeout: 20_000 });
const selectedTime = (page) => page.locator(".record-bar h2").textContent();
const shownTime = (time) => `${new Date(time).toISOString().slice(0, 19).replace("T", " ")} UTC`;
const segmentInAddress = (page) => new URLSearchParams(new URL(page.url()).hash.split("?")[1]).get("segment");
const json = async (path) => (await fetch(`${base}/v1/${path}`)).json();

/** Waits until the page shows the record that its address names. */
async function recordShown(page) {
  const segment = await json(`segments/${segmentInAddress(page)}`);
  await page.locator(".record-bar h2", { hasText: shownTime(segment.start_time) }).waitFor({ timeout: 10_000 });
  return segment;
}

async function noSidewaysScrolling(page) {
  const excess = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  assert.ok(excess <= 0, `the page is ${excess} px too wide`);
}

const CHECKS = {
  "the fleet shows the asset with its state in words": async (name) => {
    const opened = await open("");
    const row = opened.page.locator(`[data-asset="${asset}"]`);
    await row.waitFor();
    const state = row.locator(".badge");
    assert.ok((await state.innerText()).trim().length > 0);
    assert.equal(await state.locator("svg.symbol").count(), 1);
    await opened.page.getByPlaceholder("Name or id").fill("no asset has this name");
    await row.waitFor({ state: "detached" });
    await opened.page.getByPlaceholder("Name or id").fill(asset);
    await row.getByRole("link").click();
    await opened.page.waitForURL(new RegExp(`#/assets/${asset}$`));
    await drawn(opened.page, "wear");
    await close(opened, name);
  },

  "the asset's page draws its plots and marks the mesh lines": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    for (const kind of PLOTS) await drawn(opened.page, kind);
    const wear = await json(`assets/${asset}/wear`);
    if (wear.posterior) await drawn(opened.page, "posterior");
    const { mesh_harmonics: harmonics } = await json(`segments/${wear.segment_id}/spectrum`);
    const labels = opened.page.locator('[data-plot="spectrum"] .annotation-text', { hasText: /^\d+×$/ });
    assert.equal(await labels.count(), harmonics.length, "one label a mesh harmonic");
    for (const [kind, words] of [["wear", "Wear depth (µm)"], ["wear", "UTC"], ["spectrum", "Peak amplitude"], ["spectrum", "Frequency (Hz)"]]) {
      const titles = await opened.page.locator(`[data-plot="${kind}"] .infolayer`).first().textContent();
      assert.ok(titles.includes(words), `${kind} has ${JSON.stringify(words)} on an axis, but ${titles}`);
    }
    await close(opened, name);
  },

  "a click on a record selects it, and the link restores it": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    for (const kind of PLOTS) await drawn(page, kind);
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    // Plotly tells what is clicked from what is pointed at
    await page.mouse.move(area.x + 0.55 * area.width, area.y + 0.5 * area.height);
    await page.locator('[data-plot="wear"] .hoverlayer .legend, [data-plot="wear"] .hoverlayer .hovertext').first().waitFor();
    await page.mouse.click(area.x + 0.55 * area.width, area.y + 0.5 * area.height);
    await page.waitForFunction(() => location.hash.includes("segment="));
    const clicked = await recordShown(page);
    const latest = await json(`assets/${asset}/wear`);
    assert.notEqual(clicked.id, latest.segment_id, "not the latest record");

    const restored = await open(new URL(page.url()).hash);
    await recordShown(restored.page);
    assert.equal(await selectedTime(restored.page), await selectedTime(page));
    await close(restored, `${name} restored`);
    await close(opened, name);
  },

  "records are chosen by keyboard": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    for (const kind of PLOTS) await drawn(page, kind);
    await page.getByRole("button", { name: "Previous" }).focus();
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => location.hash.includes("segment="));
    const first = await recordShown(page);
    await page.keyboard.press("Enter");
    await page.waitForFunction((id) => !location.hash.includes(id), first.id);
    const second = await recordShown(page);
    assert.ok(Date.parse(second.start_time) < Date.parse(first.start_time));
    await page.goBack();
    await recordShown(page);
    assert.equal(segmentInAddress(page), first.id);
    await close(opened, name);
  },

  "a zoom is kept while new data comes in": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    for (const kind of PLOTS) await drawn(page, kind);
    const area = await page.locator('[data-plot="wear"] .nsewdrag').first().boundingBox();
    const y = area.y + 0.5 * area.height;
    await page.mouse.move(area.x + 0.4 * area.width, y);
    await page.mouse.down();
    await page.mouse.move(area.x + 0.7 * area.width, y, { steps: 5 });
    await page.mouse.up();
    const range = (kind) => page.evaluate((k) => document.querySelector(`[data-plot="${k}"] .plot`).layout.xaxis.range.map(String), kind);
    await page.waitForFunction(() => document.querySelector('[data-plot="wear"] .plot').layout.xaxis.autorange === false);
    const zoomed = await range("wear");
    await page.waitForTimeout(4500);
    assert.deepEqual(await range("wear"), zoomed);
    assert.deepEqual(await range("trends"), zoomed, "the trends show the same stretch of time");
    await close(opened, name);
  },

  "a broken file is refused in words": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await page.getByRole("button", { name: "Add records" }).click();
    await page.setInputFiles("#upload-file", { name: "broken.wav", mimeType: "audio/wav", buffer: Buffer.from("not a recording") });
    const words = page.locator('.result[data-kind="bad"]').first();
    await words.getByText("broken.wav was not taken").waitFor();
    await page.context().close();
  },

  "an unknown asset is told apart from a lost connection": async () => {
    const { page } = await open("#/assets/no-such-asset");
    await page.getByText("There is no asset “no-such-asset”").waitFor();
    assert.ok(await page.locator("#banner").isHidden());
    await page.context().close();
  },

  "a lost connection is shown and recovers": async () => {
    const { page } = await open(`#/assets/${asset}`);
    await drawn(page, "wear");
    await page.route("**/v1/**", (route) => route.abort());
    await page.getByText("Connection lost since").waitFor();
    assert.ok(await page.locator('[data-plot="wear"] .plot').isVisible(), "what was there stays");
    await page.unroute("**/v1/**");
    await page.getByRole("button", { name: "Retry now" }).click();
    await page.locator("#banner").waitFor({ state: "hidden" });
    await page.context().close();
  },

  "dark, on a phone": async (name) => {
    const options = { viewport: { width: 390, height: 844 }, colorScheme: "dark", hasTouch: true };
    const fleet = await open("", options);
    await fleet.page.locator(`[data-asset="${asset}"]`).waitFor();
    await noSidewaysScrolling(fleet.page);
    await close(fleet, `${name} fleet`);
    const opened = await open(`#/assets/${asset}`, options);
    for (const kind of PLOTS) await drawn(opened.page, kind);
    await noSidewaysScrolling(opened.page);
    await close(opened, name);
  },
};

if (shots) await mkdir(shots, { recursive: true });
let failed = 0;
for (const [name, check] of Object.entries(CHECKS)) {
  const began = Date.now();
  try {
    await check(name);
    console.log(`ok      ${name} (${Date.now() - began} ms)`);
  } catch (error) {
    failed += 1;
    console.log(`FAILED  ${name}\n${error.stack}\n`);
  }
}
await browser.close();
console.log(failed ? `${failed} of ${Object.keys(CHECKS).length} failed` : "all passed");
process.exitCode = failed ? 1 : 0;
