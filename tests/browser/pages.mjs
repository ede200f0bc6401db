// Each page with data, its links to the others, on a phone and in the dark theme.

import assert from "node:assert/strict";
import {
  asset,
  close,
  drawn,
  json,
  noSidewaysScrolling,
  open,
  overviewDrawn,
  PHONE,
  shoot,
} from "./page.mjs";

const VIEWS = [
  [`#/assets/${asset}/waterfall`, "waterfall", ["waterfall"]],
  [`#/assets/${asset}/match`, "match", ["features", "posterior", "stiffness", "transmission"]],
  [`#/assets/${asset}/settings`, "settings", []],
];

export const CHECKS = {
  "the fleet shows the asset with its state as text": async (name) => {
    const opened = await open("");
    const row = opened.page.locator(`[data-asset="${asset}"]`);
    await row.waitFor();
    const state = row.locator(".badge");
    assert.ok((await state.innerText()).trim().length > 0);
    assert.equal(await state.locator("svg.symbol").count(), 1);
    await opened.page.getByPlaceholder("Name, id or location").fill("no asset has this name");
    await row.waitFor({ state: "detached" });
    await opened.page.getByPlaceholder("Name, id or location").fill(asset);
    await row.getByRole("link").click();
    await opened.page.waitForURL(new RegExp(`#/assets/${asset}$`));
    await drawn(opened.page, "wear");
    await close(opened, name);
  },

  "the asset's page draws its plots and marks the mesh lines": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    await overviewDrawn(opened.page);
    const wear = await json(`assets/${asset}/wear`);
    if (wear.posterior) await drawn(opened.page, "posterior");
    if (wear.p25_um != null) {
      const legend = await opened.page.locator(".plot-wear").innerText();
      for (const band of ["25 to 75 %", "90 % interval"]) assert.ok(legend.includes(band), legend);
    }
    const { mesh_harmonics: harmonics } = await json(`segments/${wear.segment_id}/spectrum`);
    const labels = opened.page.locator('[data-plot="spectrum"] .annotation-text', { hasText: /^\d+×$/ });
    assert.equal(await labels.count(), harmonics.length, "one label a mesh harmonic");
    for (const [kind, words] of [
      ["wear", "Wear depth (µm)"],
      ["wear", "UTC"],
      ["spectrum", "Peak amplitude"],
      ["spectrum", "Frequency (Hz)"],
    ]) {
      const titles = await opened.page.locator(`[data-plot="${kind}"] .infolayer`).first().textContent();
      assert.ok(titles.includes(words), `${kind} has ${JSON.stringify(words)} on an axis, but ${titles}`);
    }
    const best = opened.page.locator(".fact", { hasText: "Best library state" });
    await best.getByText("fits this record best").waitFor();
    assert.match(await best.locator("[title]").first().getAttribute("title"), /the two may differ/);
    await close(opened, name);
  },

  "every page of an asset is reached by its tab": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    for (const [address, view, plots] of VIEWS) {
      await page
        .getByRole("navigation", { name: "Pages of this asset" })
        .getByRole("link", { name: view, exact: false })
        .click();
      await page.waitForURL((url) => url.hash === address);
      for (const kind of plots) await drawn(page, kind);
    }
    const [report] = await Promise.all([
      page.context().waitForEvent("page"),
      page.getByRole("link", { name: "Report" }).click(),
    ]);
    await report.waitForLoadState();
    await report.locator("h2", { hasText: "Wear depth" }).waitFor();
    assert.ok((await report.locator("figure svg").count()) >= 5);
    await report.close();
    await close(opened, name);
  },

  "a channel without records leads to the channels that have some": async (name) => {
    const { page, faults } = await open(`#/assets/${asset}?channel=gone`);
    await page.getByText("Channel “gone” has no records.").waitFor();
    await page.getByRole("link", { name: "Records", exact: true }).waitFor();
    await page.getByRole("link", { name: "gearbox/x" }).click();
    await drawn(page, "wear");
    await shoot(page, name);
    assert.ok(
      faults.every((fault) => fault.includes("404")),
      `${faults}`,
    );
    await page.context().close();
  },

  "a library shows its grid and each state's figures": async (name) => {
    const opened = await open("#/libraries");
    const { page } = opened;
    const { items } = await json("libraries");
    await page.getByRole("row").filter({ hasText: items[0].id }).getByRole("link").click();
    for (const kind of ["grid", "stiffness", "transmission"]) await drawn(page, kind);
    assert.equal(await page.locator(".state-table tbody tr").count(), items[0].states);
    const stiffness = await page.locator(".state-table tbody td:nth-child(3)").allInnerTexts();
    assert.ok(
      stiffness.every((text) => /^\d{3}\.\d$/.test(text)),
      `four digits each: ${stiffness}`,
    );
    await page.getByRole("button", { name: "Show state 3", exact: true }).click();
    await page.locator('[data-plot="stiffness"] .legend', { hasText: "state 3" }).waitFor();
    assert.match(page.url(), /state=3/);
    await close(opened, name);
  },

  "dark, on a phone": async (name) => {
    const fleet = await open("", PHONE);
    await fleet.page.locator(`[data-asset="${asset}"]`).waitFor();
    await noSidewaysScrolling(fleet.page);
    await close(fleet, `${name} fleet`);
    const opened = await open(`#/assets/${asset}`, PHONE);
    await overviewDrawn(opened.page);
    await noSidewaysScrolling(opened.page);
    for (const tab of await opened.page.locator(".tabs a:visible").all()) {
      const { x, width } = await tab.boundingBox();
      const label = await tab.innerText();
      assert.ok(x >= 0 && x + width <= PHONE.viewport.width, `${label} ends at ${x + width} px`);
    }
    await close(opened, name);
    for (const [address, view, plots] of VIEWS) {
      const shown = await open(address, PHONE);
      for (const kind of plots) await drawn(shown.page, kind);
      if (view === "settings") await shown.page.getByRole("button", { name: "Save", exact: true }).waitFor();
      await noSidewaysScrolling(shown.page);
      await close(shown, `${name} ${view}`);
    }
  },
};
