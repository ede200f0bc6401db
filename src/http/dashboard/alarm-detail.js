// Details of one alarm: its subject, the available actions, and its history.

import { fetchUnits } from "./alarm-units.js";
import {
  changeWords,
  levelWords,
  quantityWords,
  reading,
  ruleLevels,
  severityBadge,
  stateWords,
} from "./alarm-words.js";
import * as api from "./api.js";
import { h, setChildren, setText } from "./dom.js";
import { clock } from "./format.js";
import { storeName, storedName } from "./person.js";
import { format } from "./route.js";
import { instant, written, zoneName } from "./time-zone.js";

const SHELVED_FOR = [
  ["1", "1 hour"],
  ["8", "8 hours"],
  ["24", "1 day"],
  ["168", "7 days"],
  ["720", "30 days"],
  ["", "custom time:"],
];
const HOUR_MS = 3_600_000;

/** The panel beside the alarm list. */
export class AlarmDetail {
  #id;
  #alarm;
  #isActing = false;
  #nameOf;
  #head = h("div", { class: "alarm-head" });
  #history = h("ol", { class: "alarm-history" });
  #by = h("input", { id: "alarm-by", autocomplete: "name", maxlength: 200, required: true });
  #comment = h("textarea", { id: "alarm-comment", rows: 2, maxlength: 2000 });
  #span = h(
    "select",
    { id: "alarm-shelve", "aria-label": "Shelve duration", onchange: () => this.#offerTime() },
    SHELVED_FOR.map(([value, text]) => h("option", { value }, text)),
  );
  #until = h("input", {
    id: "alarm-until",
    type: "datetime-local",
    step: 60,
    "aria-label": `Shelve until, ${zoneName()}`,
    hidden: true,
  });
  #acknowledge = h(
    "button",
    { type: "button", class: "primary", onclick: () => this.#act("acknowledge") },
    "Acknowledge",
  );
  #shelve = h("button", { type: "button", onclick: () => this.#act("shelve") }, "Shelve for");
  #unshelve = h("button", { type: "button", onclick: () => this.#act("unshelve") }, "Unshelve");
  #addComment = h("button", { type: "button", onclick: () => this.#act("comment") }, "Comment");
  #result = h("p", { class: "result", role: "status", tabindex: -1 });
  #notice = h("p", { class: "notice" }, "Select an alarm to see its history, acknowledge it or shelve it.");
  #shelving = h(
    "span",
    { class: "alarm-shelving" },
    this.#shelve,
    this.#span,
    this.#until,
    h("span", { class: "muted utc-note", hidden: true }, zoneName()),
  );
  #form = h(
    "form",
    { class: "alarm-actions", onsubmit: (event) => event.preventDefault() },
    h("label", { class: "field", for: "alarm-by" }, h("span", {}, "Your name"), this.#by),
    h("label", { class: "field", for: "alarm-comment" }, h("span", {}, "Comment"), this.#comment),
    h("div", { class: "form-buttons" }, this.#acknowledge, this.#unshelve, this.#addComment, this.#shelving),
    this.#result,
  );
  #body = h(
    "div",
    { class: "alarm-body", hidden: true },
    this.#head,
    this.#form,
    h("h3", {}, "History"),
    this.#history,
  );
  element = h(
    "section",
    { class: "card alarm-detail", "aria-label": "Selected alarm", tabindex: -1 },
    this.#notice,
    this.#body,
  );

  /** `nameOf(id)` is the name of an asset. */
  constructor(nameOf) {
    this.#nameOf = nameOf;
    this.#by.value = storedName();
  }

  /** Brings the details into view and moves the focus to them. */
  focus() {
    this.element.focus({ preventScroll: true });
    this.element.scrollIntoView({ block: "start" });
  }

  /** Shows the alarm with this id, or a hint when none is selected. */
  async show(id, signal) {
    if (!id) {
      this.#id = undefined;
      return this.#nothing("Select an alarm to see its history, acknowledge it or shelve it.");
    }
    const alarm = await api.settle(api.alarm(id, signal));
    // The entered comment stays: the error may be over at the next update
    if (alarm instanceof Error)
      return this.#nothing(alarm.status === 404 ? "Alarm not found on this server." : alarm.message);
    if (id !== this.#id) {
      this.#showStatus("", "");
      this.#comment.value = "";
    }
    if (alarm === this.#alarm) return;
    await fetchUnits([alarm], signal);
    this.#id = id;
    this.#render(alarm);
  }

  #nothing(words) {
    this.#alarm = undefined;
    this.#notice.hidden = false;
    this.#body.hidden = true;
    setText(this.#notice, words);
  }

  #render(alarm) {
    this.#alarm = alarm;
    this.#notice.hidden = true;
    this.#body.hidden = false;
    const { asset_id: asset, channel, severity, value, state, rule, quantity } = alarm;
    const overview = format({ page: "asset", id: asset, query: { channel } });
    setChildren(
      this.#head,
      h("div", { class: "plot-head" }, h("h2", {}, quantityWords(quantity)), severityBadge(severity, 24)),
      h("p", {}, h("a", { href: overview }, this.#nameOf(asset)), ` · channel ${channel}`),
      h(
        "p",
        {},
        h("strong", {}, reading(value, alarm)),
        [" at the last change", levelWords(alarm)].filter(Boolean).join(", "),
        ` · ${stateWords(alarm)}`,
      ),
      h("p", { class: "muted" }, rule ? ruleWords(alarm) : "The rule of this alarm no longer exists."),
    );
    const todo = state === "unacknowledged" || state === "returned_unacknowledged";
    this.#acknowledge.hidden = !todo;
    this.#unshelve.hidden = state !== "shelved";
    const newest = [...alarm.history].reverse();
    setChildren(
      this.#history,
      newest.map((change) => entry(change, alarm)),
    );
  }

  #offerTime() {
    const own = this.#span.value === "";
    for (const element of [this.#until, this.#shelving.querySelector(".utc-note")]) element.hidden = !own;
    if (own && !this.#until.value) this.#until.value = written(Date.now() + 24 * HOUR_MS).slice(0, 16);
  }

  #end() {
    const { value } = this.#span;
    if (value) return new Date(Date.now() + Number(value) * HOUR_MS).toISOString();
    return this.#until.value ? instant(this.#until.value) : null;
  }

  async #act(action) {
    if (this.#isActing) return; // a second click before the response
    const by = this.#by.value.trim();
    const comment = this.#comment.value.trim();
    const missing = !by
      ? [this.#by, "Enter your name."]
      : action === "comment" && !comment
        ? [this.#comment, "Enter a comment."]
        : null;
    for (const input of [this.#by, this.#comment]) input.removeAttribute("aria-invalid");
    if (missing) {
      missing[0].setAttribute("aria-invalid", "true");
      missing[0].focus();
      return this.#showStatus("bad", missing[1]);
    }
    const until = action === "shelve" ? this.#end() : undefined;
    if (until === null) return this.#showStatus("bad", "Enter the time until which to shelve the alarm.");
    if (Date.parse(until) <= Date.now()) return this.#showStatus("bad", "Choose a time in the future.");
    storeName(by);
    const id = this.#id;
    this.#isActing = true;
    try {
      const alarm = await api.actOnAlarm(id, action, {
        by,
        ...(comment && { comment }),
        ...(until && { until }),
      });
      if (id !== this.#id) return; // another alarm has been selected
      this.#comment.value = "";
      const { activeElement } = document;
      this.#render(alarm);
      this.#showStatus(
        "good",
        `${{ acknowledge: "Acknowledged", shelve: `Shelved until ${clock(until)}`, unshelve: "Unshelved", comment: "Comment saved" }[action]}.`,
      );
      // The pressed button may be gone
      if (activeElement instanceof HTMLElement && activeElement.hidden) this.#result.focus();
    } catch (error) {
      if (id === this.#id) this.#showStatus("bad", `Action failed: ${error.message}.`);
    } finally {
      this.#isActing = false;
      document.dispatchEvent(new CustomEvent("recordschange"));
    }
  }

  #showStatus(kind, words) {
    this.#result.dataset.kind = kind;
    setText(this.#result, words);
  }
}

function ruleWords(alarm) {
  const { warning, danger, warning_below, danger_below, hysteresis, settings } = alarm.rule;
  const [isUpper, isLower] = [warning ?? danger, warning_below ?? danger_below].map((level) => level != null);
  const [past, back] =
    isUpper && isLower ? ["beyond", "within"] : isLower ? ["below", "above"] : ["above", "below"];
  const { raise, raise_of: of, clear, clear_of: clearOf } = settings;
  const cleared = clearOf === 1 ? "the first" : `${clear} of ${clearOf}`;
  const margin = hysteresis ? `more than ${reading(hysteresis, alarm)} ` : "";
  const raised = of === 1 ? "the first reading" : `${raise} of the last ${of} readings`;
  const counts = `raised by ${raised} ${past}, cleared by ${cleared} ${margin}${back}`;
  return `Rule: ${ruleLevels(alarm.rule, alarm)}; ${counts}.`;
}

function entry(change, alarm) {
  const { time, by, comment, withdrawn_at: withdrawn, action } = change;
  return h(
    "li",
    { class: withdrawn ? "withdrawn" : "", "data-severity": action ? "" : (change.severity ?? "none") },
    h("span", { class: "muted" }, clock(time)),
    h(
      "span",
      {},
      by ? h("strong", {}, `${by}: `) : null,
      withdrawn ? h("s", {}, changeWords(change, alarm)) : changeWords(change, alarm),
      withdrawn ? ` (withdrawn ${clock(withdrawn)}: no longer supported by the readings)` : "",
    ),
    comment ? h("q", {}, comment) : null,
  );
}
