// Files dropped on a page: on an asset's page they are imported, elsewhere a dialog explains where to drop
// them.

import { h } from "./dom.js";
import { isImportable } from "./import-preview.js";

const answered = (ask) => new Promise((resolve, reject) => ask(resolve, reject));

/** The files of a dropped entry; of a folder, those that can be imported, also in its subfolders. */
async function filesOf(entry) {
  if (entry.isFile) return [await answered((...ends) => entry.file(...ends))];
  const reader = entry.createReader();
  const inner = [];
  // A reader gives at most a hundred entries at a time
  for (let next; (next = await answered((...ends) => reader.readEntries(...ends))).length;)
    inner.push(...next);
  inner.sort((a, b) => a.name.localeCompare(b.name));
  return (await Promise.all(inner.map(filesOf))).flat().filter(isImportable);
}

/** The dropped files and those in dropped folders. */
async function filesIn(transfer) {
  // Entries are available only until the event ends
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.some(({ isDirectory }) => isDirectory)) return [...transfer.files];
  return (await Promise.all(entries.map(filesOf))).flat();
}

/** Calls back with files dropped on `element`. */
function acceptDrops(element, onFiles) {
  const hasFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  const mark = (is) => document.body.classList.toggle("dropping", is);
  element.addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    mark(true);
  });
  element.addEventListener("dragleave", (event) => event.relatedTarget || mark(false));
  element.addEventListener("drop", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault(); // otherwise the browser would leave the page to show the file
    mark(false);
    filesIn(event.dataTransfer).then(onFiles);
  });
}

function dialogWithout(files) {
  const close = h("button", { type: "button", onclick: () => dialog.close() }, "Close");
  const what = files.length === 1 ? files[0].name : `${files.length} files`;
  const words = h(
    "p",
    {},
    `${what} cannot be imported here: records belong to an asset. Open the asset and drop the files on one of its pages.`,
  );
  const dialog = h(
    "dialog",
    { class: "records", "aria-label": "Not uploaded" },
    words,
    h("div", { class: "form-buttons" }, close),
  );
  return dialog;
}

/** Handles dropped files; `current()` gives the displayed page and the id of its asset, if any. */
export function bindDrops(current) {
  let [dialog, dialogId] = [null, null];
  const show = (element) => {
    element.addEventListener("close", () => element.remove());
    document.body.append(element);
  };
  acceptDrops(document.documentElement, async (files) => {
    const { page, id } = current();
    if (page?.takeFiles) return page.takeFiles(files);
    if (id === undefined) {
      const refusal = dialogWithout(files);
      show(refusal);
      return refusal.showModal();
    }
    if (!dialog?.element.open || dialogId !== id) {
      const { RecordsDialog } = await import("./records-dialog.js");
      [dialog, dialogId] = [new RecordsDialog(id), id];
      show(dialog.element);
    }
    await dialog.take(files);
  });
}
