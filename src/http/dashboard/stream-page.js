// The live streams of an asset: scope, spectrum and level.

import * as api from "./api.js";
import { FramedPage } from "./asset-frame.js";
import { h, setChildren, setOptions, setText } from "./dom.js";
import { assetName } from "./fleet-row.js";
import { clock, hertz, number, span, unit } from "./format.js";
import { StickyRange } from "./sticky-range.js";
import { PlotCard } from "./plot-card.js";
import { replaceLine } from "./plots.js";
import { change, format } from "./route.js";
import { StreamFeed } from "./stream-feed.js";
import {
  LevelTrend,
  liveSpectrumDrawing,
  recordLine,
  scopeDrawing,
  scopeLine,
  spectrumLine,
} from "./stream-plots.js";

const TREND_S = 60;
const KEPT_S = ["5", "10", "30", "60"];
const FIND_MS = 500; // between polls for a saved record
const FIND_TIMES = 40;

function choice(id, label, options, onchange) {
  const select = h("select", { id, onchange: () => onchange(select.value) });
  setOptions(select, options);
  return { select, element: h("label", { class: "check", for: id }, label, select) };
}

/** The live view of one asset. */
export class StreamPage extends FramedPage {
  #feed = null;
  #frame = null;
  #channel = null;
  #status = { state: "connecting" };
  #frozen = false;
  #frames = 0;
  #drawing = false;
  #levels = [];
  #names = [];
  #record = null;
  #assetName = "";
  #scopeRange = new StickyRange();
  #spectrumRange = new StickyRange();
  #drawnAs = { scope: "", spectrum: "" };
  #scope = new PlotCard("scope", "Scope");
  #spectrum = new PlotCard("live-spectrum", "Spectrum");
  #trend = new LevelTrend(TREND_S);
  #state = h("p", { class: "stream-state", "data-state": "connecting" }, "Connecting…");
  #values = h("dl", { class: "stream-values" });
  #stream = choice("stream-name", "Stream", [], (name) => this.#go({ stream: name }));
  #chooseChannel = choice("stream-channel", "Channel", [], (channel) => this.#go({ channel }));
  #freeze = h(
    "button",
    {
      type: "button",
      id: "stream-freeze",
      "aria-pressed": "false",
      onclick: () => this.#setFrozen(!this.#frozen),
    },
    "Freeze",
  );
  #seconds = choice(
    "stream-seconds",
    "Last",
    KEPT_S.map((seconds) => [seconds, `${seconds} s`]),
    (seconds) => this.#go({ keep: seconds === "10" ? null : seconds }),
  );
  #keep = h(
    "button",
    { type: "button", id: "stream-keep", onclick: () => this.#saveRecord() },
    "Save as record",
  );
  #saveStatus = h("p", { class: "stream-kept", role: "status" });
  #axis = choice(
    "stream-axis",
    "Axis",
    [
      ["", "Hz"],
      ["orders", "Orders"],
    ],
    (axis) => this.#go({ axis }),
  );
  #log = this.#check("stream-log", "Log", "slog");
  #compare = this.#check("stream-compare", "Compare with last record", "compare");
  #body;

  constructor(root, route) {
    super(root, route, "live");
    this.#spectrum.tools.append(this.#axis.element, this.#log.element, this.#compare.element);
    this.#body = h(
      "div",
      { class: "stream-page" },
      h(
        "section",
        { class: "card stream-bar", "aria-label": "Stream" },
        h(
          "div",
          { class: "stream-controls" },
          this.#state,
          this.#stream.element,
          this.#chooseChannel.element,
          this.#freeze,
          h("span", { class: "stream-keep" }, this.#keep, this.#seconds.element),
        ),
        this.#saveStatus,
        h(
          "div",
          { class: "stream-levels" },
          this.#values,
          h(
            "figure",
            { class: "stream-trend" },
            this.#trend.element,
            h("figcaption", {}, `RMS (solid) and peak (dashed) over the last ${TREND_S} s`),
          ),
        ),
      ),
      this.#scope.element,
      this.#spectrum.element,
    );
    setChildren(root, this.head.element, this.#body);
  }

  #check(id, label, parameter) {
    const input = h("input", {
      type: "checkbox",
      id,
      onchange: () => this.#go({ [parameter]: input.checked ? "1" : null }),
    });
    return { input, element: h("label", { class: "check", for: id }, input, label) };
  }

  #go(parameters) {
    change(parameters, { quiet: true });
  }

  /** Reacts to a changed address. */
  update(route) {
    const before = this.query;
    this.query = route.query;
    if (before.stream !== route.query.stream) this.#forget();
    if (before.channel !== route.query.channel) {
      this.#levels = [];
      for (const range of [this.#scopeRange, this.#spectrumRange]) range.forget();
    }
    if (before.slog !== route.query.slog || before.axis !== route.query.axis) this.#spectrumRange.forget();
    this.#showChoices();
    this.redraw();
    return true;
  }

  /** Fetches the streams and the record to compare with. */
  async refresh(signal) {
    const asset = await this.loadAsset(signal);
    if (!asset) return this.#forget();
    this.#assetName = assetName(asset);
    const streams = await api.settle(api.streams(this.id, signal));
    if (streams instanceof Error) return this.#showNotice({ state: "refused", error: streams });
    this.#names = streams.items.map(({ name }) => name);
    this.#showChoices();
    if (this.#names.length === 0) return this.#showNotice({ state: "none" });
    if (!this.#feed && !this.#frozen) this.#follow();
    await this.#compareWith(signal);
  }

  get #name() {
    const { stream } = this.query;
    return stream ?? (this.#names.includes("main") ? "main" : this.#names[0]);
  }

  #forget() {
    this.#feed?.close();
    [this.#feed, this.#frame, this.#record, this.#levels] = [null, null, null, []];
    for (const range of [this.#scopeRange, this.#spectrumRange]) range.forget();
    this.#setFrozen(false, true);
  }

  #follow() {
    this.#feed?.close();
    this.#feed = new StreamFeed(
      this.id,
      this.#name,
      (frame) => this.#take(frame),
      (status) => this.#showNotice(status),
    );
  }

  /** A frozen view is sent nothing. */
  #setFrozen(is, silent = false) {
    this.#frozen = is;
    this.#freeze.setAttribute("aria-pressed", String(is));
    setText(this.#freeze, is ? "Resume" : "Freeze");
    if (silent) return;
    if (is) {
      this.#feed?.close();
      this.#feed = null;
      this.#showNotice({ state: "frozen" });
      this.redraw(); // enables hover text and saving for the frozen frame
    } else {
      this.#showNotice({ state: "connecting" });
      this.#follow();
    }
  }

  #showNotice(status) {
    this.#status = status;
    const { state, seconds, error } = status;
    const words = {
      connecting: () => "Connecting…",
      live: () => "Live",
      frozen: () => `Frozen at ${clock(this.#frame?.time)}`,
      waiting: () => `No samples for ${span(seconds)}`,
      lost: () => "Connection lost, retrying…",
      refused: () => error.message,
      none: () =>
        "This asset has no live streams. See “Live streams” in the documentation for how to send one.",
    }[state]();
    this.#state.dataset.state = state;
    this.#body.dataset.state = state;
    setText(this.#state, words);
    this.#freeze.disabled = this.#keep.disabled = ["none", "refused"].includes(state);
    if (!this.#frame && state !== "connecting") {
      this.#scope.showNotice(words);
      this.#spectrum.showNotice(words);
    }
  }

  #take(frame) {
    // The comparison record depends on the channel, whose name has just arrived
    if (!this.#frame && this.query.compare === "1") document.dispatchEvent(new CustomEvent("recordschange"));
    this.#frame = frame;
    const before = this.#channel?.name;
    this.#channel = this.#chosen(frame);
    if (this.#levels.length === 0 || before !== this.#channel.name) this.#recall(frame);
    const { rms, peak } = this.#channel;
    const now = Date.now();
    this.#levels.push({ at: now, rms, peak });
    while (this.#levels[0].at < now - 1000 * TREND_S) this.#levels.shift();
    if (this.#status.state !== "live") this.#showNotice({ state: "live" });
    this.#showChoices();
    if (!this.#drawing) this.#draw();
  }

  /** Starts the trend with earlier levels, which the service keeps for every stream. */
  async #recall(frame) {
    const [channel, name] = [frame.channels.indexOf(this.#channel), this.#name];
    const [last, now] = [Date.parse(frame.time), Date.now()];
    if (!Number.isFinite(last)) return;
    try {
      const from = new Date(last - 1000 * TREND_S).toISOString();
      const { items } = await api.streamLevels(this.id, name, from);
      if (name !== this.#name || frame.channels[channel].name !== this.#channel?.name) return;
      const recalled = items
        .map(({ time, rms, peak }) => ({
          at: now - (last - Date.parse(time)) + 1000, // the end of the second, as for a frame
          rms: rms[channel] ?? NaN,
          peak: peak[channel] ?? NaN,
        }))
        .filter(({ at }) => at < now);
      this.#levels = [...recalled, ...this.#levels.filter(({ at }) => at >= now)];
    } catch {
      // The trend then starts here
    }
  }

  #chosen({ channels }) {
    return channels.find(({ name }) => name === this.query.channel) ?? channels[0];
  }

  #showChoices() {
    const { axis, slog, compare, keep } = this.query;
    setOptions(
      this.#stream.select,
      this.#names.map((name) => [name, name]),
    );
    this.#stream.select.value = this.#name ?? "";
    this.#stream.element.hidden = this.#names.length < 2;
    const channels = this.#frame?.channels ?? [];
    setOptions(
      this.#chooseChannel.select,
      channels.map(({ name }) => [name, name]),
    );
    this.#chooseChannel.select.value = this.#channel?.name ?? "";
    this.#chooseChannel.element.hidden = channels.length < 2;
    this.#axis.select.value = axis === "orders" ? axis : "";
    this.#axis.select.disabled = Boolean(this.#frame) && !this.#frame.shaft_speed_hz;
    this.#log.input.checked = slog === "1";
    this.#compare.input.checked = compare === "1";
    this.#seconds.select.value = KEPT_S.includes(keep) ? keep : "10";
  }

  /** Fetches the spectrum of the latest record, if wanted and possibly changed. */
  async #compareWith(signal) {
    if (this.query.compare !== "1") {
      this.#record = null;
      return;
    }
    const channel = this.#channel?.name;
    if (!channel) return;
    const page = await api.settle(api.recordsPage(this.id, { channel, limit: 1, order: "desc" }, signal));
    const [segment] = page instanceof Error ? [] : page.items;
    if (!segment) {
      this.#record = null;
      return;
    }
    if (this.#record?.segment.id === segment.id) return;
    const spectrum = await api.settle(api.spectrum(segment.id, null, null, 2000, signal));
    this.#record = spectrum instanceof Error ? null : { segment, spectrum };
    await this.redraw();
  }

  /** Redraws from known data, for a changed address or theme. */
  async redraw() {
    this.#drawnAs = { scope: "", spectrum: "" };
    if (!this.#frame) return;
    this.#channel = this.#chosen(this.#frame);
    await this.#draw();
  }

  async #draw() {
    this.#drawing = true;
    try {
      const [frame, channel] = [this.#frame, this.#channel];
      this.#showValues(frame, channel);
      this.#trend.update(this.#levels);
      await Promise.all([this.#drawScope(frame, channel), this.#drawSpectrum(frame, channel)]);
      this.#frames += 1;
      this.#body.dataset.frames = String(this.#frames);
    } finally {
      this.#drawing = false;
    }
  }

  /** Redraws a plot fully if more than its last line has changed; `drawing(frame, channel)` draws a frame. */
  async #show(which, card, key, line, drawing) {
    const drawn = JSON.stringify(key);
    if (this.#drawnAs[which] === drawn) return replaceLine(card.plot, line);
    const latest = () => drawing(this.#frame, this.#channel);
    await card.show(
      () => ({ ...latest(), table: () => latest().table() }),
      `${this.id}-live-${which}`,
      () => `${this.#assetName} · ${this.#channel.name} · ${clock(this.#frame.time)}`,
    );
    this.#drawnAs[which] = drawn;
  }

  #drawScope(frame, channel) {
    const numbers = channel.scope.filter(Number.isFinite);
    const range = this.#scopeRange.fit(Math.min(...numbers), Math.max(...numbers));
    const key = [channel.name, frame.unit, frame.scope_samples, frame.sample_rate_hz, range];
    return this.#show("scope", this.#scope, key, scopeLine(frame, channel), (latest, shown) =>
      scopeDrawing(latest, shown, range),
    );
  }

  #drawSpectrum(frame, channel) {
    if (channel.bin.length === 0) {
      this.#drawnAs.spectrum = "";
      return this.#spectrum.showNotice(
        channel.invalid_samples
          ? `No spectrum: ${channel.invalid_samples} of the last samples are invalid.`
          : "Not enough samples for a spectrum yet.",
      );
    }
    const inOrders = this.query.axis === "orders" && Boolean(frame.shaft_speed_hz);
    const logarithmic = this.query.slog === "1";
    const record = this.#record?.spectrum.unit === frame.unit ? this.#record : null;
    const range = this.#amplitudes(channel, record, logarithmic);
    const { shaft_speed_hz: shaft, mesh_frequency_hz: mesh, sample_rate_hz: rate, samples } = frame;
    const key = [channel.name, frame.unit, shaft, mesh, rate, samples, inOrders, logarithmic, range];
    key.push(record?.segment.id, record && Boolean(recordLine(record.spectrum, inOrders)));
    return this.#show(
      "spectrum",
      this.#spectrum,
      key,
      spectrumLine(frame, channel, inOrders),
      (latest, shown) => liveSpectrumDrawing(latest, shown, record, { inOrders, logarithmic, range }),
    );
  }

  /** The range of the amplitudes; on a log scale it starts below the median, so that noise stays visible. */
  #amplitudes(channel, record, logarithmic) {
    const seen = record ? [...channel.amplitude, ...record.spectrum.amplitude] : [...channel.amplitude];
    const top = seen.reduce((most, value) => Math.max(most, value), 0) || 1;
    if (!logarithmic) return this.#spectrumRange.fit(0, top, { isFloor: true });
    const sorted = seen.sort((a, b) => a - b);
    const low = Math.max(sorted[sorted.length >> 1] / 5, top * 1e-8);
    return this.#spectrumRange.fit(Math.log10(low), Math.log10(top));
  }

  #showValues(frame, channel) {
    const inUnit = (value) => `${number(value, 3)} ${unit(frame.unit)}`.trim();
    const from = {
      stream: "from the stream",
      spectrum: "detected from the spectrum",
      asset: "nominal speed of the asset",
    }[frame.shaft_speed_source];
    const values = [
      ["RMS", inUnit(channel.rms), "rms"],
      ["Peak", inUnit(channel.peak), "peak"],
      ["Shaft speed", frame.shaft_speed_hz ? hertz(frame.shaft_speed_hz) : "unknown", "speed", from],
      ["Mesh frequency", frame.mesh_frequency_hz ? hertz(frame.mesh_frequency_hz) : "–", "mesh"],
      [
        "Last sample",
        clock(frame.time).slice(11),
        "time",
        `${clock(frame.time).slice(0, 10)}, index ${frame.next - 1}`,
      ],
    ];
    if (this.#values.children.length !== values.length)
      setChildren(
        this.#values,
        values.map(([label, , key]) =>
          h("div", {}, h("dt", {}, label), h("dd", { "data-value": key }), h("dd", { class: "muted" })),
        ),
      );
    values.forEach(([, text, , small], index) => {
      const [, value, note] = this.#values.children[index].children;
      setText(value, text);
      setText(note, small ?? "");
    });
  }

  /** Saves the last seconds as a record, and links to it once it is stored. */
  async #saveRecord() {
    const seconds = Number(this.#seconds.select.value);
    const channel = this.#channel?.name;
    this.#keep.disabled = true;
    setText(this.#saveStatus, "Saving…");
    try {
      const saved = await api.settle(api.keepStream(this.id, this.#name, seconds));
      if (saved instanceof Error) return setText(this.#saveStatus, `Saving failed: ${saved.message}`);
      const rate = this.#frame?.sample_rate_hz;
      const length = rate ? `${number(saved.samples / rate, 3)} s` : `${saved.samples} samples`;
      const what = `Saved ${length} from ${clock(saved.start_time)} as a record`;
      setText(this.#saveStatus, `${what}; storing…`);
      const segment = await this.#find(saved, channel);
      if (!segment)
        return setText(this.#saveStatus, `${what}. It is still being stored and will appear under Records.`);
      const href = format({ page: "asset", id: this.id, query: { channel, segment: segment.id } });
      setChildren(this.#saveStatus, `${what}. `, h("a", { href }, "Open record"));
    } catch (error) {
      setText(this.#saveStatus, `Saving failed: ${error.message}`);
    } finally {
      this.#keep.disabled = false;
    }
  }

  /** The saved record; another one may have the same start. */
  async #find({ start_time: time, samples }, channel) {
    for (let look = 0; look < FIND_TIMES; look++) {
      await new Promise((resolve) => setTimeout(resolve, look ? FIND_MS : 150));
      const page = await api.settle(api.recordsPage(this.id, { channel, from: time, limit: 10 }));
      if (page instanceof Error) continue;
      const found = page.items.find((item) => item.start_time === time && item.samples === samples);
      if (found) return found;
    }
    return null;
  }

  /** Closes the connection and releases the plots. */
  dispose() {
    this.#feed?.close();
    this.#scope.dispose();
    this.#spectrum.dispose();
  }
}
