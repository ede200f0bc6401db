// What all checks share: the browser, a page with a list of what went wrong in it, and waiting for what it shows.

import assert from "node:assert/strict";
import { join } from "node:path";
import { chromium } from "playwright-core";

function required(name) {
  const value = process.env[name];
  if (!value) throw new Error(`${name} is not set`);
  return value;
}

export const base = required("FLANKWATCH_URL").replace(/\/$/, "");
export const asset = required("FLANKWATCH_ASSET");
export const shots = process.env.FLANKWATCH_SHOTS;
export const PLOTS = ["wear", "trends", "spectrum", "envelope"];
export const PHONE = { viewport: { width: 390, height: 844 }, colorScheme: "dark", hasTouch: true };

const ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

export const browser = await chromium.launch({ executablePath: process.env.FLANKWATCH_CHROMIUM ?? "/usr/bin/chromium", args: ARGUMENTS });

/** A fresh page and the list of what went wrong in it: errors on the console, exceptions, requests to other hosts. `before` prepares the page. */
export async function open(path, options = {}, before = async () => {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, ...options });
  const page = await context.newPage();
  const faults = [];
  page.on("console", (message) => message.type() === "error" && !message.location().url.endsWith("/v1/events") && faults.push(`console: ${message.text()} ${message.location().url}`));
  page.on("pageerror", (error) => faults.push(`exception: ${error.stack}`));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (/^(https?|wss?):$/.test(url.protocol) && url.origin !== new URL(base).origin) faults.push(`outside host: ${url}`);
  });
  await before(page);
  await page.goto(`${base}/${path}`);
  return { page, faults };
}

/** Takes a picture where asked for, and fails where something went wrong in the page. */
export async function close({ page, faults }, name) {
  await shoot(page, name);
  assert.deepEqual(faults, [], "nothing goes wrong in the page");
  await page.context().close();
}

export async function shoot(page, name) {
  if (shots) await page.screenshot({ path: join(shots, `${name.replaceAll(/\W+/g, "-")}.png`), fullPage: true });
}

/** Waits until a plot is drawn. */
export const drawn = (page, kind) => page.locator(`[data-plot="${kind}"] .plot .main-svg`).first().waitFor({ state: "visible", timeout: 45_000 });

/** Waits for the plots that an asset's page begins with. */
export async function overviewDrawn(page) {
  for (const kind of PLOTS) await drawn(page, kind);
}

export const shownTime = (time) => `${new Date(time).toISOString().slice(0, 19).replace("T", " ")} UTC`;
export const parameters = (page) => new URLSearchParams(new URL(page.url()).hash.split("?")[1]);
export const json = async (path) => (await fetch(`${base}/v1/${path}`)).json();

/** Waits until the page shows the record that its address names. */
export async function recordShown(page) {
  const segment = await json(`segments/${parameters(page).get("segment")}`);
  await page.locator(".record-bar h2", { hasText: shownTime(segment.start_time) }).waitFor({ timeout: 10_000 });
  return segment;
}

export async function noSidewaysScrolling(page) {
  const excess = await page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
  assert.ok(excess <= 0, `the page is ${excess} px too wide`);
}

/** Runs `act`, a function or its source, in a page and gives the milliseconds until two frames after it have been painted. */
export function timed(page, act, argument) {
  return page.evaluate(`(async () => {
    const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
    await frame();
    const began = performance.now();
    await (${act})(${JSON.stringify(argument)});
    await frame();
    await frame();
    return performance.now() - began;
  })()`);
}
