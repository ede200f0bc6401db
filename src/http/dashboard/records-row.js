// One row of the table of records.

import { address } from "./api.js";
import { h } from "./dom.js";
import { clock, figure, hertz, recordLength, speedDoubt, speedSource, unit } from "./format.js";
import { statusMeaning, statusWords, UNUSED } from "./record-statuses.js";
import { format } from "./route.js";

export const HEADINGS = [
  "Start",
  "Channel",
  "Length",
  "Sampling rate",
  "Shaft speed",
  "RMS",
  "Status",
  "Used",
  "Raw",
];

/** A remark on the speed: why it is uncertain, or its source if that is not the mesh as usual. */
function remark(speed) {
  const words = speedDoubt(speed) ?? (speed.source === "mesh_comb" ? null : speedSource(speed));
  return words && h("span", { class: "muted id" }, words);
}

/** Whether and how a record is used in its history. */
function part({ excluded, wear }) {
  if (excluded) return "excluded";
  if (wear.status === "collecting_baseline") return "baseline";
  return UNUSED.includes(wear.status) ? "no" : "yes";
}

/** The row of a record; `onToggle(checked, withShift)` is called when its selection changes. */
export function recordRow(record, onToggle) {
  const {
    id,
    asset_id: asset,
    channel,
    start_time: start,
    samples,
    sample_rate_hz: rate,
    shaft_speed: speed,
    indicators,
    wear,
    excluded,
  } = record;
  const time = clock(start);
  const box = h("input", {
    type: "checkbox",
    "aria-label": `Select the record of ${time}, channel ${channel}`,
    onclick: (event) => onToggle(event.target.checked, event.shiftKey),
  });
  const cell = (label, ...children) => h("td", { "data-label": label }, ...children);
  return h(
    "tr",
    { "data-record": id, "data-excluded": excluded ? "true" : null },
    h("td", { class: "pick" }, box),
    h(
      "th",
      { scope: "row" },
      h("a", { href: format({ page: "asset", id: asset, query: { channel, segment: id } }) }, time),
    ),
    cell(HEADINGS[1], channel),
    cell(HEADINGS[2], recordLength(samples / rate)),
    cell(HEADINGS[3], hertz(rate)),
    cell(
      HEADINGS[4],
      speed
        ? [h("span", { title: speedSource(speed) }, `${figure(speed.shaft_speed_hz)} Hz`), remark(speed)]
        : h("span", { class: "muted" }, "not found"),
    ),
    cell(
      HEADINGS[5],
      indicators?.rms == null ? "–" : `${figure(indicators.rms)} ${unit(record.unit)}`.trim(),
    ),
    cell(
      HEADINGS[6],
      h("span", { title: `${wear.reason || statusMeaning(wear.status)}` }, statusWords(wear)),
      wear.short_reason && h("span", { class: "muted id" }, wear.short_reason),
    ),
    cell(HEADINGS[7], h("span", { class: "part" }, part(record))),
    cell(
      HEADINGS[8],
      h(
        "a",
        {
          href: address(["segments", id, "raw"]),
          download: "",
          "aria-label": `Download the raw recording of ${time}, channel ${channel}`,
        },
        "Download",
      ),
    ),
  );
}
