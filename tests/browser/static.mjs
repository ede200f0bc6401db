// Static plots of an asset's page: drawn without the plotting library until the user interacts with one.

import assert from "node:assert/strict";
import {
  asset,
  close,
  drawn,
  json,
  open,
  overviewDrawn,
  parameters,
  PHONE,
  plotOf,
  PLOTS,
  recordShown,
  seen,
} from "./page.mjs";

const libraries = (page) =>
  page.evaluate(
    () => performance.getEntriesByType("resource").filter(({ name }) => /plotly/.test(name)).length,
  );

/** Waits until all initial plots are seen. */
async function overviewSeen(page) {
  for (const kind of PLOTS) await seen(page, kind);
}

/** Lines, areas and texts of a plot by colour or words, with their place in it. */
const places = (page, kind) =>
  plotOf(page, kind).evaluate((plot) => {
    const frame = plot.getBoundingClientRect();
    const place = (element) => {
      const { left, right, top, bottom } = element.getBoundingClientRect();
      return [left - frame.left, right - frame.left, top - frame.top, bottom - frame.top];
    };
    const all = (selector) =>
      [...plot.querySelectorAll(selector)].filter(
        (element) =>
          element.checkVisibility() && !element.closest(".modebar, .hoverlayer, .trace[style*='opacity: 0']"),
      );
    const ink = (path) => getComputedStyle(path).stroke;
    return {
      texts: all("text").map((text) => [text.textContent, ...place(text)]),
      lines: all("path")
        .filter((path) => ink(path) !== "none")
        .map((path) => [ink(path), ...place(path)]),
    };
  });

/** The largest distance of a static text or line from the same one in the other drawing. */
function apart(resting, other) {
  return resting.map(([name, ...place]) => {
    const same = other.filter(([is]) => is === name);
    const distances = same.map(([, ...at]) => Math.max(...at.map((end, n) => Math.abs(end - place[n]))));
    return { name, place, distance: Math.min(Infinity, ...distances) };
  });
}

const wearLines = { median: "accent", warning: "warning", danger: "danger" };

/** The colours of a theme as computed. */
const inks = (page, names) =>
  page.evaluate(
    (wanted) =>
      Object.fromEntries(
        Object.entries(wanted).map(([key, name]) => {
          const probe = Object.assign(document.createElement("span"), { hidden: true });
          probe.style.color = `var(--${name})`;
          document.body.append(probe);
          const { color } = getComputedStyle(probe);
          probe.remove();
          return [key, color];
        }),
      ),
    names,
  );

export const CHECKS = {
  "an asset's page shows its plots without the plotting library": async (name) => {
    for (const options of [{}, { colorScheme: "dark" }, PHONE]) {
      const opened = await open(`#/assets/${asset}`, options);
      const { page } = opened;
      await overviewSeen(page);
      await page.waitForTimeout(1500);
      assert.equal(await libraries(page), 0, "nothing has asked for it");
      assert.match(await plotOf(page, "wear").getAttribute("aria-label"), /^Wear depth over \d+ records/);
      const { texts, lines } = await places(page, "wear");
      const words = texts.map(([text]) => text);
      for (const wanted of ["warning 120 µm", "danger 200 µm", "baseline", "Wear depth (µm)"])
        assert.ok(words.includes(wanted), `${wanted} among ${words}`);
      const colours = await inks(page, wearLines);
      const width = (key) => {
        const [, left, right] = lines.find(([ink]) => ink === colours[key]) ?? [];
        return right - left;
      };
      const frame = await plotOf(page, "wear").boundingBox();
      for (const key of ["warning", "danger"])
        assert.ok(width(key) > frame.width - 95, `the ${key} limit crosses the plot: ${width(key)} px`);
      assert.ok(width("median") > 0.3 * frame.width, `the median is ${width("median")} px wide`);
      const bands = await plotOf(page, "wear").evaluate(
        (plot) =>
          [...plot.querySelectorAll(".static path")].filter(
            (path) => /rgba\(/.test(path.getAttribute("fill")) && path.getBoundingClientRect().width > 60,
          ).length,
      );
      assert.equal(bands, 2, "the 50 and the 90 % band");
      await close(opened, `${name} ${options.colorScheme ?? "light"} ${options.hasTouch ? "phone" : ""}`);
    }
  },

  "the plotting library takes a plot's place without moving it": async (name) => {
    const views = [
      ["", {}],
      [
        "?log=1&trend=rms,kurtosis,mesh&bins=speed",
        { colorScheme: "dark", viewport: { width: 1440, height: 900 } },
      ],
      ["?show=waveform,turn,spectrum&near=1", PHONE],
      ["?times=local&trend=rms,velocity_rms,omx,crest_factor,fm4", { timezoneId: "Asia/Kolkata" }],
    ];
    for (const [query, options] of views) {
      const opened = await open(`#/assets/${asset}${query}`, options);
      const { page } = opened;
      const kinds = ["wear", "trends", "spectrum"];
      for (const kind of kinds) await seen(page, kind);
      await page.waitForTimeout(500);
      assert.equal(await libraries(page), 0, "these drawings are static");
      const before = {};
      for (const kind of kinds) before[kind] = await places(page, kind);
      const height = await page.evaluate(() => document.body.scrollHeight);
      for (const kind of kinds) await drawn(page, kind);
      for (const kind of kinds) {
        const after = await places(page, kind);
        const texts = apart(before[kind].texts, after.texts);
        assert.equal(texts.length, after.texts.length, `texts of ${kind}${query}`);
        for (const { name: text, distance } of texts)
          assert.ok(distance < 2, `“${text}” of ${kind}${query} moves by ${distance} px`);
      }
      const colours = await inks(page, wearLines);
      const limits = before.wear.lines.filter(([ink]) => ink === colours.warning || ink === colours.danger);
      // the curve begins at the first record and ends at the last one
      const curve = before.wear.lines.filter(([ink]) => ink === colours.median);
      assert.ok(limits.length >= 2 && curve.length === 1, JSON.stringify(before.wear.lines));
      for (const { name: ink, place, distance } of apart(
        [...limits, ...curve],
        (await places(page, "wear")).lines,
      ))
        assert.ok(distance < 2, `the line ${ink} at ${place} moves by ${distance} px${query}`);
      assert.equal(await page.evaluate(() => document.body.scrollHeight), height, "the page stays as high");
      await close(opened, `${name} ${query}`);
    }
  },

  "a pointer over a static plot gets the record's values": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewSeen(page);
    const { x, y, width, height } = await plotOf(page, "wear").boundingBox();
    await page.mouse.move(x + 0.5 * width, y + 0.5 * height);
    // the pointer does not move again
    await plotOf(page, "wear").locator(".hoverlayer", { hasText: "median" }).waitFor();
    await drawn(page, "trends");
    assert.equal(await libraries(page), 1);
    await close(opened, name);
  },

  "the first click or tap on a static plot selects its record": async (name) => {
    for (const [kind, options] of [["wear"], ["trends"], ["wear", PHONE]]) {
      const opened = await open(`#/assets/${asset}`, options);
      const { page } = opened;
      await overviewSeen(page);
      await plotOf(page, kind).scrollIntoViewIfNeeded();
      const { x, y, width, height } = await plotOf(page, kind).boundingBox();
      const place = [x + 0.5 * width, y + 0.4 * height];
      await (options ? page.touchscreen.tap(...place) : page.mouse.click(...place));
      await page.waitForFunction(() => location.hash.includes("segment="));
      const { id } = await recordShown(page);
      const { items } = await json(`assets/${asset}/wear/history`);
      const part = items.findIndex(({ segment_id: own }) => own === id) / items.length;
      assert.ok(part > 0.2 && part < 0.8, `record at ${part} of the life`);
      await close(opened, `${name} ${kind}`);
    }
  },

  "the first drag over a static plot zooms into it": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewSeen(page);
    const { x, y, width, height } = await plotOf(page, "wear").boundingBox();
    await page.mouse.move(x + 0.4 * width, y + 0.5 * height);
    await page.mouse.down();
    await page.mouse.move(x + 0.6 * width, y + 0.5 * height, { steps: 4 });
    await page.mouse.up();
    await page.waitForFunction(() => location.hash.includes("time="));
    const ends = parameters(page)
      .get("time")
      .split("~")
      .map((time) => Date.parse(time));
    await drawn(page, "trends");
    await page.waitForFunction(([from, to]) => {
      const plot = document.querySelector('[data-plot="trends"] .plot');
      const range = plot.layout?.xaxis.range.map((end) =>
        Date.parse(`${end.slice(0, 19).replace(" ", "T")}Z`),
      );
      return range && Math.abs(range[0] - from) <= 1000 && Math.abs(range[1] - to) <= 1000;
    }, ends);
    await close(opened, name);
  },

  "static plots follow the theme, the size of their card and another range": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewSeen(page);
    const accent = async () => (await inks(page, { accent: "accent" })).accent;
    const hasInk = async (ink) => (await places(page, "wear")).lines.some(([own]) => own === ink);
    const light = await accent();
    assert.ok(await hasInk(light));
    await page.emulateMedia({ colorScheme: "dark" });
    await page.waitForFunction(
      (was) => !document.querySelector('[data-plot="wear"] .static').innerHTML.includes(was),
      light,
    );
    assert.ok(await hasInk(await accent()));
    await page.setViewportSize({ width: 800, height: 900 });
    await page.waitForFunction(() => {
      const plot = document.querySelector('[data-plot="wear"] .plot');
      return Math.abs(plot.querySelector(".static").clientWidth - plot.clientWidth) < 1;
    });
    const { items } = await json(`assets/${asset}/wear/history`);
    const [from, to] = [30, 60].map((n) => items[n].start_time.slice(0, 19));
    await page.evaluate((time) => (location.hash += `?time=${time}`), `${from}Z~${to}Z`);
    await page.waitForFunction(
      (first) =>
        document.querySelector('[data-plot="trends"] .static')?.textContent.includes(first.slice(11, 16)),
      from.slice(0, 14) + String(5 * Math.ceil(Number(from.slice(14, 16)) / 5)).padStart(2, "0"),
    );
    assert.equal(await libraries(page), 0);
    await close(opened, name);
  },

  "controls that need the plotting library load it": async (name) => {
    const ways = {
      picture: async (page) => {
        const [download] = await Promise.all([
          page.waitForEvent("download"),
          page.getByRole("button", { name: "Wear over time: save as PNG" }).click(),
        ]);
        assert.match(download.suggestedFilename(), /wear.*\.png$/);
      },
      cursor: async (page) => {
        await page.getByLabel("Cursor", { exact: true }).selectOption("h");
        await page.getByRole("slider", { name: "Fundamental of the harmonic cursor" }).waitFor();
      },
      levels: async (page) => {
        await page.evaluate(() => (location.hash += "?levels=rms"));
        await page.locator('[data-plot="trends"] .alarm-levels, [data-plot="trends"] form').first().waitFor();
      },
      keyboard: async (page) => {
        await page.getByRole("button", { name: "Wear over time: save as CSV" }).focus();
        await page.keyboard.press("Tab");
      },
    };
    for (const [way, act] of Object.entries(ways)) {
      const opened = await open(`#/assets/${asset}`);
      const { page } = opened;
      await overviewSeen(page);
      await act(page);
      await page.waitForFunction(() => globalThis.Plotly);
      await overviewDrawn(page);
      assert.equal(await libraries(page), 1, way);
      await close(opened, `${name} ${way}`);
    }
  },

  "new records appear in a static plot": async (name) => {
    const cut = async (page) => {
      let asked = 0;
      await page.route("**/wear/history?*", async (route) => {
        const answer = await route.fetch();
        const history = await answer.json();
        if (asked++ === 0) history.items = history.items.slice(0, -20);
        await route.fulfill({ response: answer, json: history, headers: {} });
      });
    };
    const opened = await open(`#/assets/${asset}`, {}, cut);
    const { page } = opened;
    await overviewSeen(page);
    const label = () => plotOf(page, "wear").getAttribute("aria-label");
    const before = await label();
    await page.evaluate(() => (location.hash += "?show=spectrum"));
    await page.waitForFunction(
      (was) => document.querySelector('[data-plot="wear"] .plot').getAttribute("aria-label") !== was,
      before,
    );
    assert.equal(await libraries(page), 0);
    await close(opened, name);
  },
};
