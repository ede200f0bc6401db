// One palette says how severe something is, wherever it stands; the signal of NAMUR NE 107 is beside it.

import assert from "node:assert/strict";
import { asset, close, open } from "./page.mjs";

/** Has the list of assets hold one above its warning limit and one that learns its baseline. */
const states = (page) =>
  page.route(/\/v1\/assets\?/, async (route) => {
    const answer = await route.fetch();
    const list = await answer.json();
    const model = list.items.find(({ id }) => id === asset);
    const wear = { ...model.summary.wear, status: "estimated", median_um: 150, p05_um: 130, p95_um: 170 };
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
    await route.fulfill({
      response: answer,
      json: { ...list, items: [model, worn, alarmed, learning] },
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

  "a danger alarm outranks wear above its warning limit": async () => {
    const { page } = await open("", {}, states);
    await page.locator('tr[data-asset="alarmed"]').getByText("Danger alarm").first().waitFor();
    await page.locator('tr[data-asset="worn"]').getByText("Above warning limit").waitFor();
    await page.context().close();
  },
};
