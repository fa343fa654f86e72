"use strict";
// The page: two clocks, the pointer, the controls and the charts around a session.

const byId = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const LATEST = 0.25; // seconds of the wall that are made up for at most
const SHARPEST = 720; // pixels along the longer side
const COARSEST = 160;
const FINEST = 1; // radius of the brush: material points are a pixel apart
const SMOOTH = 28; // pictures a second: below, they are drawn coarser
const SPAN = 10; // seconds that a chart shows
const LEAST = 0.02; // least span of a chart over the range of the recording
const NARROW = 760; // pixels of a window in which panels begin folded, as in style.css

function start() {
  const run = JSON.parse(byId("run").textContent);
  const picture = byId("picture");
  const view = viewOf(run);
  const splats = new Splats(byId("drawn"), run.splats, view);
  const session = new PageSession(run, lawOf(run.law), view);
  const lines = run.outline.map((line) => line.map((at) => view.under(at)));
  const page = { run, picture, view, splats, session, lines, latency: [], frames: 0, steps: 0 };
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still) session.replay();
  byId("follow").checked = session.following;
  if (window.innerWidth <= NARROW) document.querySelectorAll("details").forEach((each) => (each.open = false));
  window.simulation = page; // for tests, and for who likes to look
  layOut(page);
  window.addEventListener("resize", () => layOut(page));
  page.pointers = new Pointers(page, (stamp) => (page.asked = page.asked || stamp));
  listenToControls(page);
  page.charts = makeCharts(session);
  page.seen = performance.now();
  page.counted = page.seen;
  page.owed = 0;
  requestAnimationFrame((now) => tick(page, now));
}

function makeCharts(session) {
  const { run } = session;
  const ranges = session.ranges();
  const [state, energy] = [ranges.state, ranges.energy].map((range) => ({ span: SPAN, least: LEAST * range }));
  const driven = run.inputs.names.length > 0;
  return {
    state: new LineChart(byId("chart-state"), run.rest.map((_, i) => `q${i + 1}`), state),
    energy: new LineChart(byId("chart-energy"), ["kinetic", "potential", "total"], energy),
    books: new LineChart(byId("chart-books"), ["hand", ...(driven ? ["inputs"] : []), "dissipated", "unexplained"], energy),
  };
}

/** Fit the picture into the window, and draw no finer than the screen shows. */
function layOut(page) {
  const { run, picture, splats } = page;
  const { width, height } = run.splats;
  const room = picture.parentElement.clientWidth;
  const across = Math.min(room, (0.78 * window.innerHeight * width) / height);
  picture.style.width = `${across}px`;
  picture.style.height = `${(across * height) / width}px`;
  page.scale = across / width; // of the screen a pixel of the training resolution
  byId("over").setAttribute("viewBox", `0 0 ${across} ${(across * height) / width}`);
  const sharp = Math.max(across, (across * height) / width) * (window.devicePixelRatio || 1);
  splats.resize(Math.round(Math.min(SHARPEST, sharp)));
  drawOutline(page);
}

function drawOutline(page) {
  const { lines, view, scale } = page;
  const path = (line) => line.map((place) => view.seen(place).map((x) => (x * scale).toFixed(1)).join(" ")).join("L");
  byId("outline").innerHTML = lines.map((line) => `<path d="M${path(line)}"/>`).join("");
  page.outlined = view.looks;
}

/** Steps are due by the wall's clock; a picture is drawn whenever the screen takes one. */
function tick(page, now) {
  const { session } = page;
  const passed = Math.max(0, now - page.seen) / 1000;
  page.seen = now;
  if (!session.paused && !session.stopped) {
    page.owed = Math.min(page.owed + (passed * session.speed) / session.dt, (LATEST * session.speed) / session.dt + 1);
    for (; page.owed >= 1; page.owed--) {
      session.step();
      record(page);
      page.steps++;
    }
  }
  show(page, now);
  requestAnimationFrame((then) => tick(page, then));
}

/** Charts hold every step, however seldom the screen takes a picture. */
function record({ session, charts }) {
  const energy = session.energy();
  const { hand, inputs, dissipated } = session.books;
  const driven = charts.books.names.includes("inputs");
  charts.state.add(session.time, session.q);
  charts.energy.add(session.time, [energy.kinetic, energy.potential, energy.total]);
  charts.books.add(session.time, [hand, ...(driven ? [inputs] : []), dissipated, session.unexplained()]);
}

function show(page, now) {
  const { session, splats, charts } = page;
  splats.draw(session.q);
  page.frames++;
  if (page.asked) page.latency.push(performance.now() - page.asked);
  page.asked = null;
  if (page.outlined !== page.view.looks) drawOutline(page);
  showHand(page);
  showVelocity(page);
  const beyond = session.isBeyond(); // looks at all of the recording
  const banner = session.banner(beyond);
  byId("banner").textContent = banner;
  byId("banner").classList.toggle("said", banner !== "");
  page.picture.classList.toggle("beyond", beyond);
  if (page.frames % 6 === 0) Object.values(charts).forEach((chart) => chart.draw());
  if (now > page.counted + 1000) showRates(page, now);
}

function showRates(page, now) {
  const rate = (count) => Math.round((1000 * count) / (now - page.counted));
  const sorted = page.latency.slice(-60).sort((a, b) => a - b);
  const late = sorted.length ? ` · drag to picture ${sorted[sorted.length >> 1].toFixed(0)} ms` : "";
  byId("rates").textContent =
    `${page.session.time.toFixed(1)} s · ${rate(page.steps)} steps/s · ${rate(page.frames)} pictures/s${late}`;
  const begun = Boolean(page.rates); // the first second also loads the page
  Object.assign(page, { counted: now, frames: 0, steps: 0, rates: [rate(page.steps), rate(page.frames)] });
  Object.values(page.charts).forEach((chart) => chart.tell());
  const { splats } = page;
  if (begun && page.rates[1] < SMOOTH) splats.resize(Math.max(COARSEST, Math.round(0.7 * splats.side)));
}

function line(id, from, to) {
  const node = typeof id === "string" ? byId(id) : id;
  [["x1", from[0]], ["y1", from[1]], ["x2", to[0]], ["y2", to[1]]].forEach(([key, x]) => node.setAttribute(key, x));
}

/** Where a first drag may begin, and where to, until there was one. */
function showHint({ session, run, pointers, view, scale }) {
  for (const id of ["hint", "ghost", "ghost-hand"]) byId(id).classList.toggle("gone", Boolean(session.everHeld));
  if (session.everHeld) return;
  const place = view.seen(view.matter.carry(session.run.rest, [pointers.lever])[0]).map((x) => x * scale);
  const tip = plus(place, run.leverWay, 0.3 * run.splats.height * scale);
  line("ghost", place, tip);
  const { style } = byId("ghost-hand");
  [style.left, style.top] = place.map((x) => `${x}px`);
  tip.forEach((x, i) => style.setProperty(["--way-x", "--way-y"][i], `${x - place[i]}px`));
}

function showHand(page) {
  const { session, picture, view, scale } = page;
  const { grip } = session;
  showHint(page);
  picture.classList.toggle("held", grip !== null);
  for (const id of ["arrow", "shade", "brush", "spread"]) byId(id).style.visibility = grip ? "visible" : "hidden";
  if (!grip) return;
  const at = grip.place(session.q);
  const place = view.seen(at).map((x) => x * scale);
  const tip = view.seen(at.map((x, i) => x + grip.force[i] / grip.gain)).map((x) => x * scale);
  byId("brush").setAttribute("cx", place[0]);
  byId("brush").setAttribute("cy", place[1]);
  byId("brush").setAttribute("r", session.radius * view.scale(at) * scale);
  const ring = ellipse(grip, at, view).map((pixel) => pixel.map((x) => x * scale).join(" "));
  byId("spread").setAttribute("d", `M${ring.join("L")}`);
  const long = Math.hypot(tip[0] - place[0], tip[1] - place[1]) > 6;
  for (const id of ["arrow", "shade"]) {
    line(id, place, tip);
    byId(id).style.visibility = long ? "visible" : "hidden";
  }
}

/** Places of the picture [px] around the ellipse that holds the held matter nine times in ten, once it rests. */
function ellipse(grip, at, view) {
  const foot = view.seen(at);
  const slopes = at.map((_, i) => plus(view.seen(at.map((x, j) => x + (i === j))), foot, -1));
  const covariance = matrixProduct([0, 1].map((k) => slopes.map((row) => row[k])), matrixProduct(grip.covariance(), slopes));
  const [[a, b], [, c]] = covariance.map((row) => row.map((x) => x * grip.nineInTen));
  const [wide, high] = [Math.sqrt(Math.max(a, 0)), Math.sqrt(Math.max(c - (a > 0 ? b ** 2 / a : 0), 0))];
  return Array.from({ length: 49 }, (_, n) => {
    const [x, y] = [Math.cos((n * Math.PI) / 24), Math.sin((n * Math.PI) / 24)];
    return [foot[0] + wide * x, foot[1] + (wide > 0 ? (b / wide) * x : 0) + high * y];
  });
}

function showVelocity({ session, run, view, scale }) {
  const group = byId("velocity");
  group.toggleAttribute("hidden", !byId("show-velocity").checked);
  if (group.hasAttribute("hidden")) return;
  const { chosen, scale: long } = run.field;
  while (group.childElementCount < chosen.length) group.append(document.createElementNS(SVG, "line"));
  const rates = view.matter.rates(session.q, session.v, chosen);
  view.matter.carry(session.q, chosen).forEach((foot, n) => {
    const tip = plus(foot, rates[n], long);
    line(group.children[n], ...[foot, tip].map((end) => view.seen(end).map((x) => x * scale)));
  });
}

/** A slider whose number stands beside it; `act` gets the number. */
function slider(id, act, read = Number, told = (x) => x.toFixed(2)) {
  const input = byId(id);
  const output = input.parentElement.querySelector("output");
  const change = (acting) => {
    const value = read(input.value);
    output.textContent = told(value);
    input.setAttribute("aria-valuetext", told(value));
    if (acting) act(value);
  };
  input.addEventListener("input", () => change(true));
  change(false);
  return input;
}

function listenToControls(page) {
  const { session, run } = page;
  const power = (text) => 10 ** Number(text);
  const times = (x) => `× ${x < 1 ? x.toFixed(2) : x.toFixed(1)}`;
  slider("speed", (x) => (session.speed = x), power, times);
  slider("strength", (x) => (session.strength = x), power, times);
  byId("radius").value = run.brush / run.splats.width;
  slider("radius", (x) => (session.radius = Math.max(FINEST, x * run.splats.width)), Number, (x) => `${(100 * x).toFixed(1)} %`);
  for (const name of ["damping", "inertia", "stiffness"]) slider(name, (x) => session.edit(name, x), Number, times);
  byId("frame").max = run.recorded.states.length - 1;
  byId("frame").value = session.frame ?? 0;
  slider("frame", (x) => session.toFrame(x), Number, (x) => x.toFixed(0));
  byId("pause").addEventListener("click", () => pause(session, !session.paused));
  byId("step").addEventListener("click", () => {
    pause(session, true);
    session.step();
    record(page);
  });
  byId("rest").addEventListener("click", () => session.rest());
  byId("front")?.addEventListener("click", () => page.view.front());
  byId("show-outline").addEventListener("change", (event) => byId("outline").toggleAttribute("hidden", !event.target.checked));
  byId("help").addEventListener("click", () => byId("card").showModal());
  byId("full").addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()));
  byId("full").hidden = !document.fullscreenEnabled;
  page.picture.addEventListener("keydown", (event) => {
    if (event.key === " ") pause(session, !session.paused);
    else if (event.key === "r" || event.key === "R") session.rest();
    else return;
    event.preventDefault();
  });
  byId("theme").addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
    document.documentElement.dataset.theme = dark ? "light" : "dark";
  });
  listenToInputs(page);
}

function pause(session, on) {
  session.paused = on;
  byId("pause").setAttribute("aria-pressed", on);
  byId("pause").textContent = on ? "Run" : "Pause";
}

function listenToInputs({ session, run }) {
  const { names, units, low, high, mean } = run.inputs;
  byId("inputs").toggleAttribute("hidden", names.length === 0);
  names.forEach((name, i) => {
    const label = document.createElement("label");
    const text = document.createTextNode(`${name} `);
    const input = Object.assign(document.createElement("input"), { id: `input${i}`, type: "range" });
    Object.assign(input, { min: low[i], max: high[i], step: (high[i] - low[i]) / 100 || 1e-6 });
    input.value = mean[i];
    label.append(text, input, document.createElement("output"));
    byId("inputs").append(label);
    slider(`input${i}`, (x) => {
      session.following = false;
      byId("follow").checked = false;
      session.u = session.u.map((old, j) => (j === i ? x : old));
    }, Number, (x) => `${x.toPrecision(2)} ${units[i]}`);
  });
  byId("follow").addEventListener("change", (event) => {
    session.following = event.target.checked;
    if (session.following && session.frame === null) session.frame = 0;
  });
}

try {
  start();
} catch (error) {
  const said = Object.assign(document.createElement("p"), { className: "broken", textContent: error.message });
  byId("picture").replaceChildren(said);
}
