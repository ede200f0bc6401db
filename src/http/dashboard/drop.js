// Files dropped anywhere on a page.

/** Calls back with files that are dropped on `element`; `abort()` of the answer ends it. */
export function acceptDrops(element, onFiles) {
  const ending = new AbortController();
  const { signal } = ending;
  const hasFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  const mark = (is) => element.classList.toggle("dropping", is);
  element.addEventListener("dragover", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    mark(true);
  }, { signal });
  element.addEventListener("dragleave", (event) => element.contains(event.relatedTarget) || mark(false), { signal });
  element.addEventListener("drop", (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    mark(false);
    onFiles([...event.dataTransfer.files]);
  }, { signal });
  return ending;
}
