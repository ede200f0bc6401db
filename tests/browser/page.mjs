// Shared by all checks: the browser, a page with a list of its errors, and waiting for its contents.

import assert from "node:assert/strict";
import { cpus, loadavg } from "node:os";
import { basename, join } from "node:path";
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

/** Limit of every wait: what is awaited comes within seconds, but a busy machine may need far longer. */
const PATIENCE = 120_000;

/** Longest wait before each request for data, to find checks that depend on the order of answers. */
const DELAY_MS = Number(process.env.FLANKWATCH_DELAY_MS ?? 0);

const ARGUMENTS = [
  "--no-sandbox",
  "--disable-gpu",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];

export const browser = await chromium.launch({
  executablePath: process.env.FLANKWATCH_CHROMIUM ?? "/usr/bin/chromium",
  args: ARGUMENTS,
});

/** A session of the browser with nothing stored. */
export async function newContext(options = {}) {
  const context = await browser.newContext(options);
  context.setDefaultTimeout(PATIENCE);
  if (DELAY_MS) await delayAnswers(context);
  return context;
}

/** Sends each request for data after a random wait, so that answers come late and in another order. */
async function delayAnswers(context) {
  await context.route(/\/v1\//, async (route) => {
    await new Promise((done) => setTimeout(done, Math.random() * DELAY_MS));
    await route.continue().catch(() => {}); // the page may be closed
  });
}

/**
 * A fresh page and the list of its errors: console errors, exceptions, requests to other hosts. `path` may be a
 * function that finds it; `before` prepares the page, `host` is another service.
 */
export async function open(path, options = {}, before = async () => {}, host = base) {
  const context = await newContext({ viewport: { width: 1280, height: 900 }, ...options });
  const page = await context.newPage();
  const faults = [];
  page.on(
    "console",
    (message) =>
      message.type() === "error" && faults.push(`console: ${message.text()} ${message.location().url}`),
  );
  page.on("pageerror", (error) => faults.push(`exception: ${error.stack}`));
  page.on("request", (request) => {
    const url = new URL(request.url());
    if (/^(https?|wss?):$/.test(url.protocol) && url.origin !== new URL(host).origin)
      faults.push(`outside host: ${url}`);
  });
  if (process.env.FLANKWATCH_PAGES) await fromFolder(context, process.env.FLANKWATCH_PAGES, host);
  await before(page);
  await page.goto(`${host}/${typeof path === "string" ? path : await path()}`);
  return { page, faults };
}

/** Serves the files of a folder instead of the server's, so that changes need no new build. */
async function fromFolder(context, folder, host) {
  await context.route("**/static/*", (route) => {
    const name = basename(new URL(route.request().url()).pathname);
    return name === "plotly.js" ? route.continue() : route.fulfill({ path: join(folder, name) });
  });
  await context.route(`${host}/`, (route) => route.fulfill({ path: join(folder, "index.html") }));
}

/** Takes a screenshot if requested, and fails if the page had errors. */
export async function close({ page, faults }, name) {
  await shoot(page, name);
  assert.deepEqual(faults, [], "nothing goes wrong in the page");
  await page.context().close();
}

export async function shoot(page, name) {
  if (shots)
    await page.screenshot({ path: join(shots, `${name.replaceAll(/\W+/g, "-")}.png`), fullPage: true });
}

/** Waits until so many elements match. */
export async function counted(locator, count) {
  const until = Date.now() + PATIENCE;
  while ((await locator.count()) !== count && Date.now() < until) await locator.page().waitForTimeout(50);
  assert.equal(await locator.count(), count);
}

/** The plot of a card: the static drawing, or Plotly's. */
export const plotOf = (page, kind) => page.locator(`[data-plot="${kind}"] .plot`);

/** Waits until a plot is seen, static or drawn by Plotly. */
export const seen = (page, kind) =>
  plotOf(page, kind).locator(":scope > .static, .main-svg").first().waitFor({ state: "visible" });

/** Waits until Plotly has drawn a plot; one that rests is woken as by a pointer. */
export async function drawn(page, kind) {
  await seen(page, kind);
  await plotOf(page, kind).dispatchEvent("pointerenter");
  await plotOf(page, kind).locator(".main-svg").first().waitFor({ state: "visible" });
}

/** Waits for the initial plots of an asset's page, drawn by Plotly. */
export async function overviewDrawn(page) {
  for (const kind of PLOTS) await drawn(page, kind);
}

export const shownTime = (time) => `${new Date(time).toISOString().slice(0, 19).replace("T", " ")} UTC`;
export const parameters = (page) => new URLSearchParams(new URL(page.url()).hash.split("?")[1]);
export const json = async (path) => (await fetch(`${base}/v1/${path}`)).json();

/** Pages by name: the path for `open`, and what waits until the page is complete. */
export const MAIN_PAGES = {
  fleet: ["", (page) => page.locator(`[data-asset="${asset}"]`).waitFor()],
  waterfall: [`#/assets/${asset}/waterfall`, (page) => drawn(page, "waterfall")],
  match: [`#/assets/${asset}/match`, (page) => drawn(page, "transmission")],
  settings: [`#/assets/${asset}/settings`, (page) => page.locator(".gear-drawing svg").waitFor()],
  records: [`#/assets/${asset}/records`, (page) => page.locator(".record-table tbody tr").first().waitFor()],
  import: [`#/assets/${asset}/import`, (page) => page.getByText("Start replay").waitFor()],
  tokens: ["#/tokens", (page) => page.getByRole("button", { name: "Create token" }).waitFor()],
  alarms: [
    async () => `#/alarms?show=all&alarm=${(await json(`alarms?asset=${asset}`)).items[0].id}`,
    (page) => page.locator(".alarm-history li").first().waitFor(),
  ],
  libraries: ["#/libraries", (page) => page.locator("tbody tr").first().waitFor()],
  library: [
    async () => `#/libraries/${(await json("libraries")).items[0].id}`,
    (page) => drawn(page, "transmission"),
  ],
};

const asJson = { "content-type": "application/json" };

/** Creates an asset for a check; `more` is added to its description. */
export async function createAsset(kind, more) {
  const id = `${kind}-${Date.now()}`;
  const spec = { id, gear: { teeth: [31, 62], shaft_speed_hz: 10 }, sensor: { unit: "m/s2" }, ...more };
  const answer = await fetch(`${base}/v1/assets`, {
    method: "POST",
    headers: asJson,
    body: JSON.stringify(spec),
  });
  assert.equal(answer.status, 201, await answer.text());
  return id;
}

export const removeAsset = (id) => fetch(`${base}/v1/assets/${id}`, { method: "DELETE" });

/** Sends a record to an asset; `more` has the samples, and what differs from the defaults. */
export async function sendRecord(id, more) {
  const defaults = { start_time: minuteTime(0), sample_rate_hz: 4000, unit: "m/s2", channel: "a1" };
  const answer = await fetch(`${base}/v1/assets/${id}/segments`, {
    method: "POST",
    headers: asJson,
    body: JSON.stringify({ ...defaults, ...more }),
  });
  const text = await answer.text();
  assert.equal(answer.status, 201, text);
  return JSON.parse(text);
}

/** A minute of the hour in which the checks' records begin. */
export const minuteTime = (minute) => `2026-03-01T08:${String(minute).padStart(2, "0")}:00Z`;

/** Sends a record of noise with an amplitude to an asset. */
export async function sendNoise(id, minute, amplitude = 1, channel = "a1") {
  const samples = Array.from(
    { length: 2000 },
    (_, n) => amplitude * (Math.sin(n * 0.49) + 0.2 * Math.sin(n * n)),
  );
  await sendRecord(id, { start_time: minuteTime(minute), channel, samples });
}

/** Waits until the page shows the record named in its address. */
export async function recordShown(page) {
  const segment = await json(`segments/${parameters(page).get("segment")}`);
  await page.locator(".record-bar h2", { hasText: shownTime(segment.start_time) }).waitFor();
  return segment;
}

export async function noSidewaysScrolling(page) {
  const excess = await page.evaluate(
    () => document.documentElement.scrollWidth - document.documentElement.clientWidth,
  );
  assert.ok(excess <= 0, `the page is ${excess} px too wide`);
}

const FAR_TOO_LONG = 5;

/**
 * Prints a measurement and the load of the machine. Other work affects these times, so only values many times
 * above the target fail.
 */
export function say(what, measured, wanted) {
  console.log(
    `        ${what}: ${measured.map((ms) => ms.toFixed(0)).join(", ")} ms (wanted: ${wanted}; load ${loadavg()[0].toFixed(1)} on ${cpus().length} cores)`,
  );
  assert.ok(Math.min(...measured) < FAR_TOO_LONG * wanted, `${what} takes ${measured} ms`);
}

/** Runs `act`, a function or its source, in a page and returns the milliseconds until two frames later. */
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
