// Arrow keys push the object; viser turns the camera with them, by their code. A key without one is a command only.
for (const kind of ["keydown", "keyup"]) {
  window.addEventListener(kind, (event) => {
    const used = event.target.closest?.("input, textarea, select, [role=slider], [role=tab], [contenteditable]");
    if (!event.isTrusted || !event.key.startsWith("Arrow") || used || event.ctrlKey || event.metaKey || event.altKey) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    document.documentElement.dispatchEvent(new KeyboardEvent(kind, { key: event.key, bubbles: true, cancelable: true }));
  }, true);
}
