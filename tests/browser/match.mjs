// The match page counts what it draws.

import assert from "node:assert/strict";
import { asset, close, drawn, open, shoot } from "./page.mjs";

/** An answer with features at 0, 1.5 and 2.5 standard deviations beside their bars, and one in the noise. */
function changed(match) {
  const feature = (name, measured, above = true) => ({
    name,
    measured_db: measured,
    scatter_db: 2,
    expected_db: 5,
    expected_interval_db: [4, 6],
    above_noise: above,
  });
  return {
    ...match,
    features: [
      feature("ln_mesh_1", 5),
      feature("ln_mesh_2", 9),
      feature("ln_mesh_3", 11),
      feature("ln_mesh_4", 30, false),
    ],
  };
}

export const CHECKS = {
  "the number of agreeing features matches the drawing": async (name) => {
    const prepare = (page) =>
      page.route("**/match", async (route) => {
        const answer = await route.fetch();
        await route.fulfill({ response: answer, json: changed(await answer.json()), headers: {} });
      });
    const opened = await open(`#/assets/${asset}/match`, {}, prepare);
    const { page } = opened;
    await drawn(page, "features");
    const counted = await page.evaluate(() => {
      const [bars, , ...points] = document.querySelector('[data-plot="features"] .plot').data;
      const measured = points.filter(({ name }) => name !== "in the noise");
      const reaches = (name, value, whisker) => {
        const at = bars.y.indexOf(name);
        return value + whisker >= bars.base[at] && value - whisker <= bars.base[at] + bars.x[at];
      };
      const each = measured.flatMap(({ x, y, error_x: { array } }) =>
        Array.from(x, (value, n) => reaches(y[n], value, array[n])),
      );
      return [each.filter(Boolean).length, each.length];
    });
    assert.deepEqual(counted, [2, 3]);
    await page
      .locator(".match-words .fact", { hasText: "Agreement with the model" })
      .getByText("2 of 3 features")
      .waitFor();
    await page
      .locator('[data-plot="features"] .plot-sub', {
        hasText: "agrees when its whisker (2 baseline standard deviations",
      })
      .waitFor();
    await close(opened, name);
  },

  "the match is shown again after a record that does not exist": async (name) => {
    const { page, faults } = await open(`#/assets/${asset}/match`);
    await drawn(page, "features");
    await page.evaluate(() => (location.hash += "?segment=0123456789abcdef"));
    await page.locator(".notice", { hasText: "0123456789abcdef" }).waitFor();
    await page.locator('[data-plot="features"]').waitFor({ state: "hidden" });
    await page.goBack();
    await page.locator('[data-plot="features"]').waitFor({ state: "visible" });
    await page.locator(".notice", { hasText: "0123456789abcdef" }).waitFor({ state: "hidden" });
    await shoot(page, name);
    assert.ok(
      faults.every((fault) => fault.includes("404")),
      `${faults}`,
    );
    await page.context().close();
  },
};
