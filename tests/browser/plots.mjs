// The contents of plots over an asset's life, and their pictures.

import assert from "node:assert/strict";
import {
  asset,
  close,
  createAsset,
  drawn,
  json,
  open,
  overviewDrawn,
  parameters,
  plotOf,
  removeAsset,
  seen,
  sendNoise,
} from "./page.mjs";

/** Serves a wear history: baseline, estimates, baseline after new gears, estimates. */
const twoLives = (page) =>
  page.route("**/wear/history*", async (route) => {
    const answer = await route.fetch();
    const history = await answer.json();
    const quarter = Math.floor(history.items.length / 4);
    const none = {
      reference_wear_um: null,
      median_um: null,
      low_um: null,
      p25_um: null,
      p75_um: null,
      high_um: null,
    };
    const known = { reference_wear_um: null, median_um: 40, low_um: 30, p25_um: 35, p75_um: 45, high_um: 50 };
    history.items.forEach((item, n) =>
      Object.assign(
        item,
        Math.floor(n / quarter) % 2
          ? { ...known, status: "estimated" }
          : { ...none, status: "collecting_baseline" },
      ),
    );
    await route.fulfill({ response: answer, json: history, headers: {} });
  });

/** Asks the server for a few points of the whole life, as for an asset with far more records. */
const reduced = async (page) => {
  for (const path of ["**/wear/history?*", "**/indicators?*"])
    await page.route(path, (route) =>
      route.continue({ url: route.request().url().replace("max_points=2000", "max_points=20") }),
    );
};

/** The times of the records drawn between two instants. */
const recordsDrawn = (page, kind, [from, to]) =>
  page.evaluate(
    ([key, low, high]) => {
      const { data } = document.querySelector(`[data-plot="${key}"] .plot`);
      const { x } = data?.find(({ customdata }) => customdata) ?? { x: [] };
      return x.map((time) => Date.parse(time)).filter((time) => time >= low && time <= high);
    },
    [kind, from, to],
  );

/** Waits until exactly these records are drawn between two instants: the words are there before the lines. */
async function onlyDrawn(page, kind, range, wanted, words = kind) {
  let shown = await recordsDrawn(page, kind, range);
  for (let looks = 0; looks < 500 && String(shown) !== String(wanted); looks++) {
    await page.waitForTimeout(200);
    shown = await recordsDrawn(page, kind, range);
  }
  assert.deepEqual(shown, wanted, words);
}

const wear = (page, read) => page.evaluate(`(${read})(document.querySelector('[data-plot="wear"] .plot'))`);

export const CHECKS = {
  "a single record has minutes to either side": async (name) => {
    const id = await createAsset("lone");
    await sendNoise(id, 0);
    const opened = await open(`#/assets/${id}`);
    await drawn(opened.page, "trends");
    const [from, to] = await opened.page.evaluate(
      () => document.querySelector('[data-plot="trends"] .plot').layout.xaxis.range,
    );
    assert.equal(Date.parse(to) - Date.parse(from), 600_000);
    await close(opened, name);
    await removeAsset(id);
  },

  "a plot follows the size of its card": async (name) => {
    const opened = await open(`#/assets/${asset}`);
    const { page } = opened;
    await overviewDrawn(page);
    await page.evaluate(() => {
      document.querySelector(".asset-grid").style.gridTemplateColumns = "minmax(0, 1fr)";
    });
    await page.waitForFunction(() =>
      ["wear", "trends", "spectrum"].every((kind) => {
        const plot = document.querySelector(`[data-plot="${kind}"] .plot`);
        return (
          plot.clientWidth > 1000 &&
          Math.abs(plot.querySelector(".main-svg").clientWidth - plot.clientWidth) < 1
        );
      }),
    );
    await close(opened, name);
  },

  "a zoom in time draws every record of its range": async (name) => {
    const { items } = await json(`assets/${asset}/wear/history?max_points=20000`);
    const starts = items.map(({ start_time: time }) => Date.parse(time));
    const opened = await open(`#/assets/${asset}`, {}, reduced);
    const { page } = opened;
    await overviewDrawn(page);
    const kinds = ["wear", "trends"];
    for (const kind of kinds) {
      await page.locator(`[data-plot="${kind}"] .plot-sub`).getByText("Reduced for display").waitFor();
      const whole = await recordsDrawn(page, kind, [starts[0], starts.at(-1)]);
      assert.ok(whole.length < starts.length / 2, `${whole.length} of ${starts.length} records of ${kind}`);
    }
    const plane = page.locator('[data-plot="wear"] .nsewdrag').first();
    await plane.scrollIntoViewIfNeeded();
    const { x, y, width, height } = await plane.boundingBox();
    await page.mouse.move(x + 0.3 * width, y + 0.5 * height);
    await page.mouse.down();
    await page.mouse.move(x + 0.5 * width, y + 0.5 * height, { steps: 6 });
    await page.mouse.up();
    await page.waitForFunction(() => location.hash.includes("time="));
    const range = parameters(page)
      .get("time")
      .split("~")
      .map((time) => Date.parse(time));
    const inside = starts.filter((time) => time >= range[0] && time <= range[1]);
    for (const kind of kinds) {
      await page.locator(`[data-plot="${kind}"] .plot-sub`).getByText("Every record").waitFor();
      await onlyDrawn(page, kind, range, inside);
      const all = await recordsDrawn(page, kind, [starts[0], starts.at(-1)]);
      assert.deepEqual(
        all,
        [...all].sort((a, b) => a - b),
        "in the order of time",
      );
    }
    await page.reload();
    for (const kind of kinds) {
      await drawn(page, kind);
      await page.locator(`[data-plot="${kind}"] .plot-sub`).getByText("Every record").waitFor();
      await onlyDrawn(page, kind, range, inside, `the link restores ${kind}`);
    }
    await close(opened, name);
  },

  "the velocity zones are drawn behind the trend": async (name) => {
    const limits = [10, 20, 40];
    const id = await createAsset("zones", { velocity_zones: { limits_mm_per_s: limits } });
    for (let minute = 0; minute < 4; minute++) await sendNoise(id, minute, 4 + 4 * minute);
    for (const [colorScheme, scale] of [
      ["light", ""],
      ["dark", ""],
      ["light", "&log=1"],
    ]) {
      const opened = await open(`#/assets/${id}?trend=rms,velocity_rms${scale}`, { colorScheme });
      const { page } = opened;
      await drawn(page, "trends");
      const { bands, colours, velocities, range } = await page.evaluate(() => {
        const { layout, _fullLayout: full, data } = document.querySelector('[data-plot="trends"] .plot');
        const probe = document.body.appendChild(document.createElement("i"));
        const colourOf = (key) => {
          probe.style.color = `var(--${key})`;
          return getComputedStyle(probe).color.match(/\d+/g).slice(0, 3).join(", ");
        };
        return {
          bands: layout.shapes.filter(({ name }) => name?.startsWith("zone")),
          colours: ["normal", "learning", "warning", "danger"].map(colourOf),
          velocities: data.filter(({ yaxis, mode }) => yaxis === "y2" && mode === "lines+markers")[0].y,
          range: full.yaxis2.range.map((end) => (full.yaxis2.type === "log" ? 10 ** end : end)),
        };
      });
      assert.deepEqual(
        bands.map(({ name: zone, yref, y0, y1 }) => [
          zone,
          yref,
          limits.includes(y0) ? y0 : "",
          limits.includes(y1) ? y1 : "",
        ]),
        [
          ["zone A", "y2", "", 10],
          ["zone B", "y2", 10, 20],
          ["zone C", "y2", 20, 40],
          ["zone D", "y2", 40, ""],
        ],
      );
      bands.forEach(({ fillcolor }, n) => assert.ok(fillcolor.includes(`(${colours[n]}, `), fillcolor));
      assert.ok(bands[0].y0 <= range[0] && bands[3].y1 > range[1], "the outer zones have no end in view");
      // velocities from 1.5 to 6: the first limit is in view; the others would flatten the data
      const [least, greatest] = [Math.min(...velocities), Math.max(...velocities)];
      assert.ok(range[0] < least && range[0] >= (scale ? 0.5 * least : 0), `from ${range[0]}`);
      assert.ok(greatest > 5 && greatest < 10 && range[1] > 10, `${greatest}, axis to ${range[1]}`);
      assert.ok(range[1] < 30, `axis to ${range[1]}`);
      assert.deepEqual(await page.locator('[data-plot="trends"] .legend li').allTextContents(), [
        "Zone A, up to 10 mm/s",
        "Zone B, up to 20 mm/s",
        "Zone C, up to 40 mm/s",
        "Zone D, above 40 mm/s",
      ]);
      await close(opened, `${name} ${colorScheme}${scale}`);
    }
    await removeAsset(id);
  },

  "a pane of the trend has one unit": async (name) => {
    const opened = await open(
      `#/assets/${asset}?trend=rms,velocity_rms,kurtosis,omx,crest_factor,fm4,na4,novelty,mesh,residual_variance,peak`,
    );
    const { page } = opened;
    await drawn(page, "trends");
    const panes = await page.evaluate(() => {
      const { layout, data } = document.querySelector('[data-plot="trends"] .plot');
      const columns = data
        .filter(({ yaxis }) => yaxis)
        .map(({ yaxis, y }) => [yaxis.slice(1), Array.from(y)]);
      return Object.keys(layout)
        .filter((key) => key.startsWith("yaxis"))
        .map((key) => ({
          title: layout[key].title.text,
          curves: columns.filter(([of]) => `yaxis${of}` === key).map(([, y]) => y),
        }));
    });
    const { units, items } = await json(
      `assets/${asset}/indicators?names=rms,velocity_rms,kurtosis,omx,crest_factor,fm4,na4,novelty,residual_variance,peak,${Array.from({ length: 10 }, (_, n) => `mesh_${n + 1}`)}`,
    );
    assert.equal(panes.length, 11);
    const written = { "m/s2": "m/s²", "(m/s2)^2": "(m/s²)²", 1: "" };
    for (const { title, curves } of panes) {
      // the drawn values belong to these names
      const names = Object.keys(units).filter((key) =>
        curves.some((y) => y.length > 9 && items.every((item, n) => item[key] === y[n])),
      );
      assert.ok(names.length >= 1, `${title} shows ${names}`);
      const own = new Set(names.map((key) => units[key]));
      assert.equal(own.size, 1, `${title} shows ${names} in ${[...own]}`);
      const [unit] = own;
      const words = unit in written ? written[unit] : unit;
      assert.ok(words ? title.endsWith(`(${words})`) : !/m\/s/.test(title), `${title} in ${unit}`);
    }
    await close(opened, name);
  },

  "numbers of a trend fit beside its axis": async (name) => {
    const id = await createAsset("steady", { baseline: { records: 8 } });
    for (let minute = 0; minute < 10; minute++) await sendNoise(id, minute, 0.0174 * (1 + 0.004 * minute));
    const opened = await open(`#/assets/${id}?trend=rms,velocity_rms,kurtosis`, { deviceScaleFactor: 2 });
    const { page } = opened;
    const plot = plotOf(page, "trends");
    await seen(page, "trends");
    const overlaps = () =>
      plot.evaluate((element) => {
        const { left } = element.getBoundingClientRect();
        const texts = [...element.querySelectorAll("svg text")].filter(({ textContent }) => textContent);
        const boxes = texts.map((text) => ({ text, box: text.getBoundingClientRect() }));
        const isTitle = ({ text }) => / \(.*\)$/.test(text.textContent);
        const isOver = ({ box: a }, { box: b }) =>
          a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
        return boxes
          .filter(
            (one) =>
              one.box.left < left - 1 ||
              (isTitle(one) && boxes.some((other) => other !== one && isOver(one, other))),
          )
          .map(({ text }) => text.textContent);
      });
    assert.deepEqual(await overlaps(), [], "drawn still");
    await drawn(page, "trends");
    assert.deepEqual(await overlaps(), [], "drawn by the library");
    // a signal of a calibrator differs by less than its digits: the axis does not enlarge that
    const { range } = await plot.evaluate(({ _fullLayout: layout }) => layout.yaxis3);
    assert.ok(range[1] - range[0] > 9e-4 * range[1], `${range}`);
    await close(opened, name);
    await removeAsset(id);
  },

  "each baseline is shaded separately": async (name) => {
    const opened = await open(`#/assets/${asset}`, {}, twoLives);
    const { page } = opened;
    await drawn(page, "wear");
    const zones = await wear(
      page,
      "({ layout }) => layout.shapes.filter(({ type, y0, y1 }) => type === 'rect' && y0 === 0 && y1 === 1).map(({ x0, x1 }) => [x0, x1])",
    );
    assert.equal(zones.length, 2, JSON.stringify(zones));
    assert.ok(zones[0][1] < zones[1][0], "estimates lie between them");
    await close(opened, name);
  },

  "a record without an estimate is not drawn as zero wear": async (name) => {
    const opened = await open(`#/assets/${asset}`, {}, twoLives);
    const { page } = opened;
    await drawn(page, "wear");
    const zeros = await wear(
      page,
      "({ data }) => data.filter(({ yaxis = 'y', opacity = 1 }) => yaxis === 'y' && opacity > 0).flatMap(({ y }) => Array.from(y)).filter((depth) => depth === 0).length",
    );
    assert.equal(zeros, 0);
    await page.locator('[data-plot="wear"] .legend', { hasText: "records without an estimate" }).waitFor();
    await close(opened, name);
  },

  "ticks of a logarithmic trend are full, ascending numbers": async (name) => {
    const opened = await open(`#/assets/${asset}?log=1&trend=rms,mesh`);
    const { page } = opened;
    await drawn(page, "trends");
    for (const axis of ["y", "y2"]) {
      const ticks = await page
        .locator(`[data-plot="trends"] .${axis}tick text`)
        .evaluateAll((list) =>
          list.map((text) => [Number(text.textContent), -text.getBoundingClientRect().top]),
        );
      const places = ticks.sort(([a], [b]) => a - b).map(([, place]) => place);
      assert.ok(
        places.length > 1 && places.every((place, n) => n === 0 || place > places[n - 1]),
        `${axis}: ${ticks}`,
      );
    }
    await close(opened, name);
  },

  "header, sentence and alarms are about one channel and name the other": async (name) => {
    const settings = { raise: 1, raise_of: 1, clear: 1, clear_of: 1 };
    const id = await createAsset("channels", {
      alarms: [{ quantity: { indicator: "rms" }, danger: 4, settings }],
    });
    for (let minute = 0; minute < 3; minute++)
      for (const [channel, amplitude] of [
        ["a1", 1],
        ["a2", 20],
      ])
        await sendNoise(id, minute, amplitude, channel);
    const opened = await open(`#/assets/${id}?channel=a1`);
    const { page } = opened;
    await page.locator(".whole-asset", { hasText: "Danger alarm" }).waitFor();
    assert.doesNotMatch(await page.locator(".state-line > .badge").innerText(), /alarm/i);
    assert.match(await page.locator(".sentence").innerText(), /^Channel a1: /);
    await page.locator(".events-card li", { hasText: "Channel a2: RMS" }).waitFor();
    await page.locator(".whole-asset a", { hasText: "channel a2" }).click();
    await page.locator(".state-line > .badge", { hasText: "Danger alarm" }).waitFor();
    assert.match(await page.locator(".sentence").innerText(), /^Channel a2: /);
    assert.equal(await page.locator(".whole-asset").count(), 0);
    await close(opened, name);
    await removeAsset(id);
  },

  "a saved picture has its title and legend on white": async (name) => {
    for (const colorScheme of ["light", "dark"]) {
      const opened = await open(`#/assets/${asset}`, { colorScheme });
      const { page } = opened;
      await overviewDrawn(page);
      const [download] = await Promise.all([
        page.waitForEvent("download"),
        page.getByRole("button", { name: "Wear over time: save as PNG" }).click(),
      ]);
      const chunks = [];
      for await (const chunk of await download.createReadStream()) chunks.push(chunk);
      const { width, height, corner, inks, plot } = await page.evaluate(
        async (bytes) => {
          const bitmap = await createImageBitmap(new Blob([new Uint8Array(bytes)]));
          const canvas = Object.assign(document.createElement("canvas"), {
            width: bitmap.width,
            height: bitmap.height,
          });
          const context = canvas.getContext("2d");
          context.drawImage(bitmap, 0, 0);
          const element = document.querySelector('[data-plot="wear"] .plot');
          const head = context.getImageData(
            0,
            0,
            bitmap.width,
            bitmap.height - 2 * element.clientHeight,
          ).data;
          const inked = new Set();
          for (let n = 0; n < head.length; n += 4) inked.add(`${head[n]},${head[n + 1]},${head[n + 2]}`);
          return {
            width: bitmap.width,
            height: bitmap.height,
            corner: [...context.getImageData(0, 0, 1, 1).data],
            inks: inked.size,
            plot: [element.clientWidth, element.clientHeight],
          };
        },
        [...Buffer.concat(chunks)],
      );
      assert.equal(width, 2 * plot[0]);
      assert.ok(height > 2 * plot[1] + 60, "there is room for title and legend");
      assert.ok(inks > 10, "and something in it");
      assert.deepEqual(corner, [255, 255, 255, 255]);
      await close(opened, `${name} ${colorScheme}`);
    }
  },
};
