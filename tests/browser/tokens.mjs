// The token page: creating, showing once, and revoking; hidden from callers without the scope.

import assert from "node:assert/strict";
import { join } from "node:path";
import { newContext, close, open, shots } from "./page.mjs";

const guarded = process.env.FLANKWATCH_GUARDED_URL;
const token = process.env.FLANKWATCH_TOKEN;

async function logIn(address, words, options = {}) {
  const context = await newContext(options);
  const page = await context.newPage();
  await page.goto(`${guarded}/${address}`);
  await page.getByRole("dialog").getByLabel("Token").fill(words);
  await page.getByRole("button", { name: "Log in" }).click();
  return page;
}

const asked = (path, words) =>
  fetch(`${guarded}/v1/${path}`, { headers: { authorization: `Bearer ${words}` } });

export const CHECKS = guarded && {
  "a token is created, shown once, and revoked": async (name) => {
    const page = await logIn("#/tokens", token);
    await page.getByRole("row", { name: /desk.*this session/ }).waitFor();
    await page.getByRole("link", { name: "Tokens" }).waitFor();
    await page.getByRole("button", { name: "Create token" }).click();
    await page.getByText("Enter a name.").waitFor();
    await page.getByLabel("Name", { exact: true }).fill("display");
    await page.getByLabel("read").check();
    await page.getByRole("button", { name: "Create token" }).dblclick();
    const made = await page.getByLabel("Token display", { exact: true }).inputValue();
    assert.match(made, /^fwt_[0-9a-f]{8}_[0-9a-f]{64}$/);
    assert.equal((await asked("assets", made)).status, 200);
    assert.equal((await asked("tokens", made)).status, 403);
    assert.ok(
      !JSON.stringify(await (await asked("tokens", token)).json()).includes(made.split("_")[2]),
      "no list holds the secret",
    );
    if (shots)
      await page.screenshot({ path: join(shots, `${name.replaceAll(/\W+/g, "-")}.png`), fullPage: true });
    await page.reload();
    await page.getByRole("row", { name: /display/ }).waitFor();
    assert.equal(
      await page.getByRole("row", { name: /display/ }).count(),
      1,
      "a second click is no second one",
    );
    assert.equal(await page.getByLabel("Token display", { exact: true }).count(), 0, "it is shown once");

    const other = await logIn("#/tokens", made);
    await other.getByText("has scope read, expected admin").waitFor();
    await other.locator("#tokens-link").waitFor({ state: "hidden" });
    await other.context().close();

    page.on("dialog", (dialog) => dialog.accept());
    await page.getByRole("button", { name: "Revoke token display" }).click();
    await page.getByText("Token “display” revoked.").waitFor();
    assert.equal((await asked("assets", made)).status, 401);
    await page.getByRole("button", { name: "Revoke token desk" }).click();
    await page.getByText("is the last one with scope admin").waitFor();
    assert.equal((await asked("assets", token)).status, 200);
    await page.context().close();
  },

  "creating the first token warns that tokens become required": async (name) => {
    const opened = await open("#/tokens");
    const { page } = opened;
    await page.getByText("every request needs one.").waitFor();
    assert.ok(await page.getByLabel("admin").isChecked());
    assert.ok(await page.getByLabel("read").isDisabled());
    await close(opened, name);
  },
};
