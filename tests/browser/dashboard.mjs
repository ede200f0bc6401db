// The dashboard in a real browser, against a running server.
//
// FLANKWATCH_URL: the service, for example http://127.0.0.1:8600
// FLANKWATCH_ASSET: an asset with a library and at least a few estimated records
// FLANKWATCH_CHROMIUM: the browser (default /usr/bin/chromium)
// FLANKWATCH_PART: run only the checks of "analysis" or of "operation" (optional)
// FLANKWATCH_GUARDED_URL, FLANKWATCH_TOKEN: a service that requires this token with scope admin, with an
// asset “pump”
// FLANKWATCH_EMPTY_URL, FLANKWATCH_RECORDS: a service without assets, and a folder of WAV files of a run to
// failure of the preset “shen2022”
// FLANKWATCH_REPLAYS: the replay folder of FLANKWATCH_URL, with “shift.mcap” of six records a minute apart,
// of the start of the asset's run (optional)
// FLANKWATCH_PAGES: a folder of pages to use instead of those built into the server
// FLANKWATCH_SHOTS: a folder for screenshots (optional)
// FLANKWATCH_DELAY_MS: longest random wait before each request of a page for data (optional)
// FLANKWATCH_ONLY: run only checks whose file and name ("fleet: 500 assets") contain this, or one of several
// texts separated by "|"

import { mkdir } from "node:fs/promises";
import { browser, shots } from "./page.mjs";

// Parts that run beside each other take about the same time.
const PARTS = {
  analysis: [
    "pages",
    "severity",
    "record",
    "spectrum",
    "plots",
    "static",
    "match",
    "views",
    "without-gears",
    "report",
    "links",
    "downloads",
    "bench",
    "baseline-lines",
    "times",
    "live",
  ],
  operation: [
    "stream",
    "connection",
    "alarms",
    "alarm-levels",
    "upload",
    "import",
    "import-channels",
    "records",
    "setup",
    "setup-draft",
    "journey",
    "session",
    "tokens",
    "fleet",
    "keyboard",
    "focus",
    "accessibility",
    "speed",
  ],
};
const part = process.env.FLANKWATCH_PART;
const files = part ? PARTS[part] : Object.values(PARTS).flat();
if (!files) throw new Error(`FLANKWATCH_PART is ${part}, expected one of: ${Object.keys(PARTS).join(", ")}`);
const only = (process.env.FLANKWATCH_ONLY ?? "").split("|");

if (shots) await mkdir(shots, { recursive: true });
const failures = [];
let run = 0;
for (const file of files) {
  const { CHECKS } = await import(`./${file}.mjs`);
  for (const [name, check] of Object.entries(CHECKS ?? {}).filter(([name]) =>
    only.some((text) => `${file}: ${name}`.includes(text)),
  )) {
    const began = Date.now();
    run += 1;
    try {
      await check(name);
      console.log(`ok      ${file}: ${name} (${Date.now() - began} ms)`);
    } catch (error) {
      failures.push(`FAILED  ${file}: ${name}\n${error.stack}\n`);
      console.log(`FAILED  ${file}: ${name} (${Date.now() - began} ms)`);
    }
  }
}
await browser.close();
// At the end, where a long log is read first.
for (const failure of failures) console.log(failure);
console.log(failures.length ? `${failures.length} of ${run} failed` : `all ${run} passed`);
// A failed check may leave a server open, which would keep the process running.
process.exit(failures.length ? 1 : 0);
