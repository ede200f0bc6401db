// Links to copy or edit an asset, and its deletion, at the end of its settings.

import * as api from "./api.js";
import { h, setText } from "./dom.js";
import { go } from "./route.js";

/** The card; deletion requires typing the asset's id. */
export function removalCard(id) {
  const typed = h("input", {
    id: "removal-id",
    type: "text",
    autocomplete: "off",
    spellcheck: "false",
    oninput: () => (remove.disabled = typed.value.trim() !== id),
  });
  const result = h("p", { class: "result", role: "status" });
  const remove = h(
    "button",
    { type: "button", class: "danger", disabled: true, onclick: send },
    "Delete asset",
  );

  async function send() {
    remove.disabled = true;
    try {
      await api.deleteAsset(id);
      go({ page: "fleet" });
    } catch (error) {
      result.dataset.kind = "bad";
      setText(result, `Deleting failed: ${error.message}.`);
      remove.disabled = false;
    }
  }

  const link = (query, words) =>
    h("a", { class: "button", href: `#/new?${query}=${encodeURIComponent(id)}` }, words);
  return h(
    "section",
    { class: "card removal" },
    h("h2", {}, "This asset"),
    h("div", { class: "form-buttons" }, link("edit", "Edit gears and all fields…"), link("copy", "Copy…")),
    h(
      "details",
      {},
      h("summary", {}, "Delete this asset"),
      h(
        "p",
        {},
        "This also deletes its records, estimates and alarms. Raw recordings are moved to quarantine.",
      ),
      h(
        "div",
        { class: "form-buttons" },
        h("label", { class: "field", for: "removal-id" }, h("span", {}, `Type ${id} to delete it`), typed),
        remove,
      ),
      result,
    ),
  );
}
