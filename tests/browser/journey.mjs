// From an empty service to a report, without leaving the browser.

import assert from "node:assert/strict";
import { readdir } from "node:fs/promises";
import { join } from "node:path";
import { close, drawn, open, shoot } from "./page.mjs";
import { fill } from "./setup.mjs";

const empty = process.env.FLANKWATCH_EMPTY_URL?.replace(/\/$/, "");
const folder = process.env.FLANKWATCH_RECORDS;

export const CHECKS = empty && {
  "an empty service, an asset, a preview, records, wear, an alarm, an inspection and a report": async (
    name,
  ) => {
    const opened = await open("", { viewport: { width: 1440, height: 900 } }, undefined, empty);
    const { page } = opened;
    await page.getByText("No assets yet").waitFor();
    const steps = page.locator(".first-steps");
    await steps.getByText("drop WAV, FLAC, CSV").waitFor();
    assert.ok(await steps.getByText("curl").first().isHidden(), "the commands are folded away");
    await shoot(page, `${name} first steps`);
    await steps.getByRole("link", { name: "New asset" }).click();

    await fill(page, { Name: "Press line 3" });
    await page.getByLabel("Gear pair, for wear in µm").selectOption("shen2022");
    await page.locator('.measures [data-quantity="contact_ratio"][data-verdict="good"]').waitFor();
    await drawn(page, "preview-spectrum");
    await page.locator("#preview-wear").fill("245");
    await page.locator('.preview[data-wear="245"]').waitFor();
    await fill(page, {
      "Default unit of samples": "m/s2",
      "Warning (µm)": "25",
      "Danger (µm)": "60",
      "Baseline records": "8",
    });
    await page.getByRole("button", { name: "Create asset" }).click();

    const waiting = page.locator("section.empty");
    await waiting.getByText("drop WAV, FLAC, CSV").waitFor();
    assert.ok(await waiting.locator("pre").isHidden());
    await waiting.getByText("Or with the API").click();
    await waiting.locator("pre", { hasText: "curl" }).waitFor();
    await waiting.getByRole("button", { name: "Add records…" }).click();
    const files = (await readdir(folder))
      .filter((file) => file.endsWith(".wav"))
      .sort()
      .map((file) => join(folder, file));
    assert.equal(files.length, 30);
    await page.setInputFiles("#upload-file", files);
    await page.getByRole("button", { name: "Upload 30 files" }).click();
    await page.locator('.result[data-kind="good"]').nth(29).waitFor();
    await page.getByRole("button", { name: "Close" }).click();

    await page.locator(".facts", { hasText: "complete, 8 records" }).waitFor();
    await page.locator(".wear-now strong", { hasText: "µm" }).waitFor();
    await page
      .locator(".verdict .badge", { hasText: /danger|warning/i })
      .first()
      .waitFor();
    await drawn(page, "wear");
    await shoot(page, `${name} wear`);

    await page.getByRole("link", { name: /^Alarms/ }).click();
    await page.locator(".alarms").getByRole("link", { name: "Wear depth" }).first().click();
    const detail = page.getByRole("region", { name: "Selected alarm" });
    await detail.getByLabel("Your name").fill("Ada");
    await detail.getByRole("button", { name: "Acknowledge" }).click();
    await detail.getByText("Acknowledged.").waitFor();

    await page.getByRole("link", { name: "Fleet" }).first().click();
    await page.getByRole("link", { name: "Press line 3" }).click();
    await drawn(page, "wear");
    await page.getByRole("button", { name: "Add maintenance" }).click();
    await page.getByLabel("Wear measured").check();
    await page.getByLabel("Your name").fill("Grace");
    await page.getByLabel("Measured depth (µm)").fill("240");
    await page.getByRole("button", { name: "Save", exact: true }).click();
    await page
      .getByRole("region", { name: "Alarms and maintenance" })
      .getByText("240 ± 5 µm")
      .first()
      .waitFor();

    const [report] = await Promise.all([
      page.context().waitForEvent("page"),
      page.getByRole("link", { name: "Report" }).click(),
    ]);
    await report.waitForLoadState();
    await report.getByRole("heading", { name: "Press line 3" }).first().waitFor();
    assert.match(await report.locator("body").innerText(), /Wear depth/);
    await shoot(report, `${name} report`);
    await close(opened, name);
  },
};
