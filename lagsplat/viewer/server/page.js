// What viser's page lacks: arrow keys that push, controls that begin folded on a phone, and names of its parts.
const FIELDS = "input, textarea, select, [role=slider], [role=tab], [contenteditable]";
const NARROW = 576; // pixels of a window in which viser lays its controls over the picture

// Viser turns the camera with arrows, by their code. A key without one is a command only.
for (const kind of ["keydown", "keyup"]) {
  window.addEventListener(kind, (event) => {
    const used = event.target.closest?.(FIELDS) || event.ctrlKey || event.metaKey || event.altKey;
    if (!event.isTrusted || !event.key.startsWith("Arrow") || used) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    document.documentElement.dispatchEvent(new KeyboardEvent(kind, { key: event.key, bubbles: true, cancelable: true }));
  }, true);
}

if (window.innerWidth <= NARROW) {
  const folding = new MutationObserver(() => {
    const handle = [...document.querySelectorAll("div[style*='cursor: pointer']")].find((one) => one.style.height === "3.5em");
    if (!handle) return;
    folding.disconnect();
    handle.click();
  });
  folding.observe(document.documentElement, { childList: true, subtree: true });
}
