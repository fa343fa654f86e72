// What viser's page lacks: arrow keys that push, full screen, the colours and the motion that a browser asks for, controls
// that begin folded on a phone, and names and values of its parts in words.
const FIELDS = "input, textarea, select, [role=slider], [role=tab], [contenteditable]";
const NARROW = 576; // pixels of a window in which viser lays its controls over the picture

const LOOK = `
:root[data-mantine-color-scheme="dark"] { --mantine-color-dimmed: #b9bec6 !important; }
:root[data-mantine-color-scheme="light"] { --mantine-color-dimmed: #565d67 !important; }
:root[data-mantine-color-scheme="light"] { --mantine-primary-color-filled: #2069a8 !important; --mantine-color-anchor: #2069a8 !important; }
:root[data-mantine-color-scheme="light"] { --mantine-primary-color-filled-hover: #17588f !important; }
:root[data-mantine-color-scheme="light"] .mantine-Button-root[data-variant="outline"] .mantine-Button-label { color: #17588f; }
:root[data-mantine-color-scheme="dark"] [role="tab"][aria-selected="true"] { color: #8cbee8 !important; }
.mantine-Slider-markLabel { color: var(--mantine-color-dimmed) !important; font-size: 0.65rem !important; }
#screen { position: fixed; left: 0.6rem; bottom: 0.6rem; z-index: 5; display: flex; gap: 0.4rem; }
#screen button { font: 0.85rem system-ui, sans-serif; color: inherit; background: transparent; border: 1px solid currentcolor;
  border-radius: 8px; padding: 0.3rem 0.7rem; cursor: pointer; }
:root[data-mantine-color-scheme="dark"] #screen { color: #e4e7eb; }
:root[data-mantine-color-scheme="light"] #screen { color: #1d2229; }
@media (max-width: ${NARROW}px) { #screen { bottom: 4.2rem; } }
.mantine-Notification-description { color: inherit !important; }
#heading { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); margin: 0; }
@media (prefers-reduced-motion: reduce) { * { transition: none !important; animation: none !important; } }`;
document.head.append(Object.assign(document.createElement("style"), { textContent: LOOK }));
document.documentElement.lang = "en";
document.body.insertAdjacentHTML("afterbegin", `<header><h1 id="heading">Push a model live</h1></header>
<nav id="screen" aria-label="Screen"><button id="full">Full screen</button>
<button id="theme" aria-label="Dark or light">◐</button></nav>`);

const byId = (id) => document.getElementById(id);
const isOther = (event) => event.target.closest?.(FIELDS) || event.ctrlKey || event.metaKey || event.altKey;
/** Run the command of a key, as if it were pressed. */
const command = (kind, key) => document.documentElement.dispatchEvent(new KeyboardEvent(kind, { key, bubbles: true, cancelable: true }));

function changeFullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen();
}
byId("full").hidden = !document.fullscreenEnabled;
byId("full").addEventListener("click", changeFullScreen);
window.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "f" && document.fullscreenEnabled && !isOther(event)) changeFullScreen();
});

const darkness = window.matchMedia("(prefers-color-scheme: dark)");
let chosen = null; // by the button, until the browser changes its mind
const shown = () => document.documentElement.dataset.mantineColorScheme;
/** Ask the server, which colours viser's page, for the colours of the browser. */
function changeColors() {
  const wanted = chosen ?? (darkness.matches ? "dark" : "light");
  if (shown() !== wanted) command("keydown", wanted === "dark" ? "d" : "l");
}
darkness.addEventListener("change", () => {
  chosen = null;
  changeColors();
});
byId("theme").addEventListener("click", () => {
  chosen = shown() === "dark" ? "light" : "dark";
  changeColors();
});

// Viser turns the camera with arrows, by their code. A key without one is a command only.
for (const kind of ["keydown", "keyup"]) {
  window.addEventListener(kind, (event) => {
    if (!event.isTrusted || !event.key.startsWith("Arrow") || isOther(event)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    command(kind, event.key);
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

/** The value of a slider in words, with the unit that stands in brackets in its name. */
function tellValue(slider) {
  const unit = slider.getAttribute("aria-label")?.match(/\((.*)\)/)?.[1] ?? "";
  const value = slider.getAttribute("aria-valuenow");
  const told = unit === "log10" ? `${Number((10 ** value).toPrecision(2))} times` : `${value} ${unit === "×" ? "times" : unit}`;
  slider.setAttribute("aria-valuetext", told.trim());
}
new MutationObserver((changes) => changes.forEach(({ target }) => tellValue(target)))
  .observe(document.documentElement, { subtree: true, attributeFilter: ["aria-valuenow"] });

/** Name what viser leaves without a name: sliders and numbers by their label, buttons by their icon. */
function nameParts() {
  document.getElementById("root")?.setAttribute("role", "main");
  document.title ||= "LaGSplat";
  for (const field of document.querySelectorAll("[role=slider], input")) {
    const row = field.closest(":has(label)");
    const name = row?.querySelector("label").textContent;
    if (name && !field.getAttribute("aria-label")) field.setAttribute("aria-label", name);
    if (field.role === "slider") tellValue(field);
  }
  for (const button of document.querySelectorAll("button:not([aria-label])")) {
    const icon = button.querySelector("svg")?.getAttribute("class")?.match(/tabler-icon-([\w-]+)/)?.[1];
    const close = button.className.includes("CloseButton");
    if (!button.textContent.trim()) button.setAttribute("aria-label", close ? "Close" : ICONS[icon] ?? icon?.replaceAll("-", " ") ?? "More");
  }
}

let [waiting, begun] = [false, false];
new MutationObserver(() => {
  if (waiting) return;
  waiting = true;
  setTimeout(() => {
    waiting = false;
    nameParts();
    if (!document.querySelector("sub")) return; // the line of rates comes after all commands
    changeColors();
    if (!begun && window.matchMedia("(prefers-reduced-motion: reduce)").matches) command("keydown", "r");
    begun = true;
  }, 500);
}).observe(document.documentElement, { childList: true, subtree: true, attributeFilter: ["data-mantine-color-scheme"] });
