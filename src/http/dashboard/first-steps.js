// First steps, shown on a server without assets.

import { h } from "./dom.js";

/** A command with its description and a copy button. */
function command(title, text) {
  const button = h("button", { type: "button", class: "quiet" }, "Copy");
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Copy manually";
    }
  });
  return [
    h("div", { class: "command-head" }, title, button),
    h("pre", { tabindex: "0" }, h("code", {}, text)),
  ];
}

/** The steps to a first wear estimate, with this server's address filled in. */
export function firstSteps() {
  const base = new URL(".", document.baseURI).href.replace(/\/$/, "");
  const asset = `curl -X POST ${base}/v1/assets -H 'content-type: application/json' -d '{
  "id": "pump-north", "name": "Pump north",
  "gear": { "teeth": [32, 80], "shaft_speed_hz": 29.7 },
  "limits": { "warning_um": 100, "danger_um": 150 }
}'`;
  const record = `curl -X POST '${base}/v1/assets/pump-north/segments?unit=m/s2&start_time=2026-03-02T06:00:00Z' \\
  -H 'content-type: audio/wav' --data-binary @record.wav`;
  return h(
    "section",
    { class: "card first-steps" },
    h("h2", {}, "No assets yet"),
    h(
      "p",
      {},
      "An asset is one gear mesh, or a machine without gears, measured by one or more accelerometers. Create one, then add vibration records. The first 20 records, taken while the machine is healthy, form the baseline.",
    ),
    h(
      "ol",
      {},
      h(
        "li",
        {},
        h("h3", {}, "Create an asset"),
        h(
          "p",
          { class: "first-step" },
          h("a", { class: "button primary", href: "#/new" }, "New asset"),
          " shows the gear pair and a preview as you type.",
        ),
      ),
      h(
        "li",
        {},
        h("h3", {}, "Add records"),
        h(
          "p",
          {},
          "Choose “Add records…” on its page, or drop WAV, FLAC, CSV, MATLAB, NumPy or MCAP files there. Each file is shown before it is uploaded.",
        ),
      ),
      h(
        "li",
        {},
        h("h3", {}, "Read the wear"),
        h(
          "p",
          {},
          "After the baseline, each record has indicators, and with a gear pair a wear depth in µm.",
        ),
      ),
    ),
    h(
      "details",
      { class: "first-commands" },
      h("summary", {}, "Or with the API, or with a simulated gear"),
      command(h("h3", {}, "Create an asset"), asset),
      command(h("h3", {}, "Send a vibration record"), record),
      command(h("h3", {}, "Watch a simulated gear wear out"), "flankwatch demo"),
      h(
        "p",
        { class: "muted" },
        "Teeth: driving gear, then driven gear. Shaft speed: driving shaft, in Hz. A wear estimate in µm also needs the gear pair (gear.pair); without it, only indicators are computed. This page shows the asset as soon as it exists.",
      ),
    ),
  );
}
