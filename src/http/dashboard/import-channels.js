// The channels of one file of the import panel: name and unit of each, and a sketch of its samples.

import { h, setChildren } from "./dom.js";
import { count, unit } from "./format.js";
import { UNITS } from "./known-units.js";
import { sketch } from "./sketch.js";

const MAX_CHANNELS = 16; // with fields of their own
const MAX_TOPICS = 6;
const BLOCKS = ["application/json", "application/x-protobuf"]; // these name channel and unit themselves
const PARTS = { "text/csv": "the start", "application/mcap": "its first record" };

/** Whether channels of a media type can be given other names. */
const isMapped = (type) => !BLOCKS.includes(type);

/** Whether a channel of a file with `channels` has a unit of its own, beside that for all files. */
const hasUnit = (type, channels) => type !== "audio/wav" || channels > 1;

function topics(summary) {
  if (!summary) return null;
  const shown = summary.topics
    .slice(0, MAX_TOPICS)
    .map(({ topic, messages }) => h("li", {}, h("code", {}, topic), ` ${count(messages)}`));
  const more = summary.topics.length - MAX_TOPICS;
  return h(
    "ul",
    { class: "file-topics" },
    shown,
    more > 0 ? h("li", { class: "muted" }, `and ${more} more`) : null,
  );
}

/** The list of channels of a file; `onChange` is called when a name changes. */
export class ImportChannels {
  #file;
  #onChange;
  #seen = { channels: [] };
  #fields = []; // { name, unit } inputs of each channel
  #drawings = []; // of each channel with a row
  element = h("div", { class: "file-channels" });

  constructor(file, onChange) {
    [this.#file, this.#onChange] = [file, onChange];
  }

  /** Whether samples need a unit that the file does not contain. */
  get lackUnit() {
    const { type, channels } = this.#seen;
    return Boolean(type) && isMapped(type) && channels.some(({ unit: own }) => !own);
  }

  /** Whether samples of a channel have no unit, neither in the file nor entered for the channel. */
  get lackEnteredUnit() {
    const entered = this.entries();
    return this.lackUnit && this.#seen.channels.some(({ unit: own }, n) => !own && !entered[n].unit);
  }

  /** Forgets the entered names and units. */
  clear() {
    this.#fields = [];
  }

  /**
   * Shows the channels of a preview; what was entered for them stays.
   * @param {any} seen
   */
  show(seen) {
    /** @param {any} known */
    const asText = ({ type, channels }) =>
      JSON.stringify([type, channels.map(({ name, unit: own }) => [name, own])]);
    const isSame = this.#fields.length > 0 && asText(seen) === asText(this.#seen);
    this.#seen = seen;
    if (isSame) this.#redraw();
    else this.#list();
  }

  /** Draws the samples only: the fields stay, since one of them may have the focus. */
  #redraw() {
    for (const [n, drawn] of this.#drawings.entries())
      setChildren(drawn, this.#sketch(this.#seen.channels[n], n));
  }

  #list() {
    const { channels, summary } = this.#seen;
    const kept = this.#fields.map(({ name, unit: own }) => ({ name: name.value, unit: own?.value }));
    if (channels.length) this.#fields = []; // entries outlast a preview that fails
    this.#drawings = [];
    const rows = channels.slice(0, MAX_CHANNELS).map((channel, n) => this.#row(channel, n, kept[n]));
    const more =
      channels.length > MAX_CHANNELS
        ? h("p", { class: "muted" }, `and ${channels.length - MAX_CHANNELS} more channels`)
        : null;
    setChildren(this.element, rows, more, topics(summary));
  }

  #of(channel, n) {
    return `${channel.name || `channel ${n + 1}`} of ${this.#file.name}`;
  }

  #sketch(channel, n) {
    if (!channel.sketch) return [];
    const part = PARTS[this.#seen.type] ?? "a sample of it";
    return [
      sketch(channel.sketch, this.#of(channel, n)),
      channel.sketch.whole ? null : h("span", { class: "muted" }, part),
    ];
  }

  #row(channel, n, kept) {
    const { type, channels } = this.#seen;
    const label = channel.name || `channel ${n + 1}`;
    const of = this.#of(channel, n);
    const drawn = h("div", {}, this.#sketch(channel, n));
    this.#drawings.push(drawn);
    if (!isMapped(type)) {
      const words = [label, unit(channel.unit)].filter(Boolean).join(", ");
      return h("div", { class: "file-channel" }, h("p", {}, words), drawn);
    }
    const isNamed = channels.length > 1 || ["text/csv", "application/mcap"].includes(type);
    const name = h("input", {
      placeholder: isNamed ? channel.name : "default channel",
      "aria-label": `Name of ${of}`,
      size: 8,
      onchange: this.#onChange,
    });
    const own = hasUnit(type, channels.length)
      ? h("input", {
          placeholder: "as above",
          "aria-label": `Unit of ${of}`,
          list: UNITS,
          size: 6,
          disabled: Boolean(channel.unit), // the file's own unit takes precedence
        })
      : null;
    name.value = kept?.name ?? (type === "text/csv" && channels.length > 1 ? channel.name : "");
    if (own) own.value = channel.unit || (kept?.unit ?? "");
    this.#fields.push({ name, unit: own });
    return h(
      "div",
      { class: "file-channel" },
      h("label", { class: "field" }, h("span", {}, "Channel"), name),
      own && h("label", { class: "field" }, h("span", {}, "Unit"), own),
      drawn,
    );
  }

  /** The names that the channels will have; a single one without a name has none. */
  names() {
    const { type, channels } = this.#seen;
    const isNamed = BLOCKS.includes(type) || ["application/mcap", "text/csv"].includes(type);
    return channels.map(({ name }, n) => {
      // A single channel without a name is the default channel in every file
      const standing = isNamed || channels.length > 1 ? String(name || n + 1) : "";
      return this.#fields[n]?.name.value.trim() || standing;
    });
  }

  /** What was entered, with the name of each channel in the file, `recorded`, and its `place` among columns. */
  entries() {
    return this.#seen.channels.map(({ name: recorded, place }, n) => {
      const { name, unit: own } = this.#fields[n] ?? {};
      return {
        recorded,
        place,
        // A column without a field keeps its heading
        name: name ? name.value.trim() : recorded,
        unit: !own || own.disabled ? "" : own.value.trim(),
      };
    });
  }
}
