// What viser's page lacks: arrow keys that push, controls that begin folded on a phone, and names of its parts.
const FIELDS = "input, textarea, select, [role=slider], [role=tab], [contenteditable]";
const NARROW = 576; // pixels of a window in which viser lays its controls over the picture

const LOOK = `
:root[data-mantine-color-scheme="dark"] { --mantine-color-dimmed: #b9bec6 !important; }
:root[data-mantine-color-scheme="light"] { --mantine-color-dimmed: #565d67 !important; }
#heading { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); margin: 0; }
@media (prefers-reduced-motion: reduce) { * { transition: none !important; animation: none !important; } }`;
document.head.append(Object.assign(document.createElement("style"), { textContent: LOOK }));
document.documentElement.lang = "en";
document.body.insertAdjacentHTML("afterbegin", '<header><h1 id="heading">Push a model live</h1></header>');

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

const ICONS = { "list-search": "Commands", adjustments: "Settings", maximize: "Enlarge", x: "Close" };

/** Name what viser leaves without a name: sliders and numbers by their label, buttons by their icon. */
function nameParts() {
  document.getElementById("root")?.setAttribute("role", "main");
  document.title ||= "LaGSplat";
  for (const field of document.querySelectorAll("[role=slider], input")) {
    const row = field.closest(":has(label)");
    const name = row?.querySelector("label").textContent;
    if (name && !field.getAttribute("aria-label")) field.setAttribute("aria-label", name);
  }
  for (const button of document.querySelectorAll("button:not([aria-label])")) {
    const icon = button.querySelector("svg")?.getAttribute("class")?.match(/tabler-icon-([\w-]+)/)?.[1];
    const close = button.className.includes("CloseButton");
    if (!button.textContent.trim()) button.setAttribute("aria-label", close ? "Close" : ICONS[icon] ?? icon?.replaceAll("-", " ") ?? "More");
  }
}

let waiting = false;
new MutationObserver(() => {
  if (waiting) return;
  waiting = true;
  setTimeout(() => {
    waiting = false;
    nameParts();
  }, 500);
}).observe(document.documentElement, { childList: true, subtree: true });
