// With tokens required: logging in, using the session, and logging out.

import assert from "node:assert/strict";
import { newContext } from "./page.mjs";

const guarded = process.env.FLANKWATCH_GUARDED_URL;
const token = process.env.FLANKWATCH_TOKEN;

async function logIn(page, words) {
  await page.getByRole("dialog").getByLabel("Token").fill(words);
  await page.getByRole("button", { name: "Log in" }).click();
}

export const CHECKS = guarded && {
  "a session opens the report, is shared between tabs, and ends": async () => {
    const context = await newContext();
    const page = await context.newPage();
    await page.goto(`${guarded}/#/assets/pump`);
    await logIn(page, "fwt_00000000_0");
    await page.getByText("Unknown token.").waitFor();
    await logIn(page, token);
    await page.locator("h1", { hasText: "pump" }).waitFor();

    await page.locator('#live[data-state="live"]').waitFor();
    const opened = context.waitForEvent("page");
    await page.getByRole("link", { name: "Report" }).click();
    const report = await opened;
    await report.waitForLoadState();
    assert.equal((await report.request.get(report.url())).status(), 200);
    assert.match(await report.title(), /pump/);
    await report.close();

    const [cookie] = await context.cookies();
    assert.deepEqual([cookie.httpOnly, cookie.sameSite], [true, "Strict"]);
    assert.equal(
      await page.evaluate(() => document.cookie + JSON.stringify({ ...sessionStorage })),
      "{}",
      "no script reads the token",
    );
    await page.close();
    const other = await context.newPage();
    await other.goto(`${guarded}/#/assets/pump/settings`);
    await other.getByLabel("Name", { exact: true }).fill("Pump of the test");
    await other.getByRole("button", { name: "Save" }).first().click();
    await other.locator("h1", { hasText: "Pump of the test" }).waitFor();

    await other.getByRole("button", { name: "Log out" }).click();
    await other.getByRole("dialog").getByLabel("Token").waitFor();
    assert.deepEqual(await context.cookies(), []);
    await context.close();
  },

  "only the dialog says that a token is required": async () => {
    const context = await newContext();
    const page = await context.newPage();
    await page.goto(`${guarded}/`);
    await page.locator('#live[data-state="failed"]').waitFor({ state: "attached" });
    assert.equal(await page.getByRole("dialog").isVisible(), true);
    assert.equal(await page.locator("#banner").isVisible(), false);
    await context.close();
  },

  "an answer to a request from before the login does not ask for a token again": async () => {
    const context = await newContext();
    const page = await context.newPage();
    const held = new Promise((resolve) => page.route("**/v1/session", resolve, { times: 1 }));
    await page.goto(`${guarded}/#/assets/pump`);
    const early = await held;
    await logIn(page, token);
    await page.locator("h1", { hasText: "pump" }).waitFor();
    const answered = page.waitForResponse((response) => response.request() === early.request());
    await early.fulfill({ status: 401, json: {} });
    await answered;
    await page.evaluate(() => new Promise((next) => setTimeout(next, 100)));
    assert.equal(await page.getByRole("dialog").isVisible(), false);
    await context.close();
  },
};
