// One palette shows severity everywhere, with the NAMUR NE 107 signal beside it.

import assert from "node:assert/strict";
import { asset, close, drawn, open } from "./page.mjs";

/** Serves an asset list: one above its warning limit, one with an alarm, one unclear, one in its baseline. */
const states = (page) =>
  page.route(/\/v1\/assets\?/, async (route) => {
    const answer = await route.fetch();
    const list = await answer.json();
    const model = list.items.find(({ id }) => id === asset);
    const wear = { ...model.summary.wear, status: "estimated", median_um: 150, low_um: 130, high_um: 170 };
    const worn = { ...model, id: "worn", name: "Worn", summary: { ...model.summary, wear, alarms: {} } };
    const learning = {
      ...model,
      id: "learning",
      name: "Learning",
      summary: {
        ...model.summary,
        wear: { status: "collecting_baseline", baseline: { have: 3, need: 20 } },
        alarms: {},
      },
    };
    const alarmed = {
      ...worn,
      id: "alarmed",
      name: "Alarmed",
      summary: { ...worn.summary, alarms: { danger: 1, warning: 0, unacknowledged: 1, shelved: 0 } },
    };
    const unidentified = { ...wear, status: "not_identifiable", median_um: 234, low_um: 0, high_um: 201 };
    const unclear = {
      ...alarmed,
      id: "unclear",
      name: "Unclear",
      limits: { danger_um: 180 },
      summary: { ...alarmed.summary, wear: unidentified },
    };
    await route.fulfill({
      response: answer,
      json: { ...list, items: [model, worn, alarmed, unclear, learning] },
      headers: {},
    });
  });

export const CHECKS = {
  "a state above a limit has that limit's colour": async (name) => {
    for (const colorScheme of ["light", "dark"]) {
      const opened = await open("", { colorScheme }, states);
      const { page } = opened;
      const row = (id) => page.locator(`tr[data-asset="${id}"]`);
      await row("worn").getByText("Above warning limit").waitFor();
      const fill = (id) =>
        row(id)
          .locator(".symbol .outline")
          .evaluate((path) => getComputedStyle(path).fill);
      const limit = await row("worn")
        .locator(".limit-warning")
        .evaluate((mark) => getComputedStyle(mark).borderLeftColor);
      const pressed = await page.evaluate(() => {
        const probe = document.body.appendChild(document.createElement("i"));
        probe.style.color = "var(--accent)";
        return getComputedStyle(probe).color;
      });
      assert.equal(await fill("worn"), limit);
      assert.notEqual(await fill("worn"), pressed, "it is not that of a pressed button");
      assert.notEqual(await fill("learning"), limit, "learning is no warning");
      await row("worn").getByRole("img", { name: "NE 107 maintenance required" }).waitFor();
      await row("learning").getByRole("img", { name: "NE 107 function check" }).waitFor();
      await close(opened, `${name} ${colorScheme}`);
    }
  },

  "fleet, verdict, limits and alarms have one palette, with NE 107 beside it": async (name) => {
    for (const colorScheme of ["light", "dark"]) {
      const opened = await open("", { colorScheme }, states);
      const { page } = opened;
      const palette = await page.evaluate(() => {
        const probe = document.body.appendChild(document.createElement("i"));
        const keys = ["normal", "warning", "danger", "unsure", "learning"];
        return Object.fromEntries(
          keys.map((key) => [key, ((probe.style.color = `var(--${key})`), getComputedStyle(probe).color)]),
        );
      });
      assert.equal(new Set(Object.values(palette)).size, 5, "each severity has a colour of its own");
      /** The severity, the colour and the NE 107 signal of every badge on the page. */
      const badges = async (place) => {
        await page.locator(`${place} .badge`).first().waitFor();
        return page
          .locator(`${place} .badge`)
          .evaluateAll((all) =>
            all.map((badge) => [
              badge.dataset.severity,
              getComputedStyle(badge.querySelector(".symbol .outline")).fill,
              badge.querySelector(".namur")?.getAttribute("aria-label") ?? "",
            ]),
          );
      };
      const seen = [...(await badges(".fleet"))];
      await page.goto(new URL(`#/assets/${asset}`, page.url()).href);
      await drawn(page, "wear");
      seen.push(...(await badges("main")));
      const lines = await page.evaluate(() =>
        document
          .querySelector('[data-plot="wear"] .plot')
          .layout.shapes.filter(({ type, y0, y1 }) => type === "line" && y0 === y1)
          .map(({ y0, line }) => [y0, line.color]),
      );
      for (const [level, severity] of [
        [120, "warning"],
        [200, "danger"],
      ])
        assert.equal(
          lines.find(([at]) => at === level)?.[1],
          palette[severity],
          `${level} µm in ${JSON.stringify(lines)}`,
        );
      await page.goto(new URL("#/alarms?show=all", page.url()).href);
      seen.push(...(await badges(".alarms")));
      assert.ok(new Set(seen.map(([severity]) => severity)).size >= 3, JSON.stringify(seen));
      const signals = {
        danger: "NE 107 failure",
        warning: "NE 107 maintenance required",
        learning: "NE 107 function check",
        normal: "",
      };
      for (const [severity, colour, namur] of seen) {
        assert.equal(colour, palette[severity], severity);
        if (severity in signals) assert.equal(namur, signals[severity], severity);
      }
      await close(opened, `${name} ${colorScheme}`);
    }
  },

  "a danger alarm outranks wear above its warning limit": async () => {
    const { page } = await open("", {}, states);
    await page.locator('tr[data-asset="alarmed"]').getByText("Danger alarm").first().waitFor();
    await page.locator('tr[data-asset="worn"]').getByText("Above warning limit").waitFor();
    const wear = page.locator('tr[data-asset="unclear"] .wear-number');
    assert.equal(await wear.textContent(), "unclear0 to 201 µm", "no number, whatever the alarm");
    await page.context().close();
  },

  "an alarm is the first sentence about an asset, and a link": async () => {
    const quantity = { indicator: "rms" };
    const rule = { quantity, warning: 10, danger: 19.9, hysteresis: 1 };
    const { page } = await open(`#/assets/${asset}`, {}, async (page) => {
      const alarm = { id: "a1", asset_id: asset, channel: "gearbox/x", quantity, rule, value: 20.1 };
      const raised = { ...alarm, severity: "danger", state: "unacknowledged", history: [] };
      await page.route(/\/v1\/alarms\?/, (route) => route.fulfill({ json: { items: [raised] } }));
      await page.route(/\/v1\/alarms\/a1/, (route) => route.fulfill({ json: raised }));
      await page.route(new RegExp(`/v1/assets/${asset}$`), async (route) => {
        const answer = await route.fetch();
        const json = await answer.json();
        json.summary.alarms = { danger: 1, warning: 0, unacknowledged: 1, shelved: 0 };
        json.limits = {};
        await route.fulfill({ response: answer, json });
      });
    });
    const link = page.locator(".sentence a", { hasText: "Danger alarm: RMS 20.1 m/s², above 19.9 m/s²" });
    assert.match(await link.getAttribute("href"), /alarm=a1/);
    await page.context().close();
  },
};
