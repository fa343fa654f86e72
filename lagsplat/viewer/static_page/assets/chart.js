"use strict";
// A small chart of the last seconds: one line a name, its own scale, drawn on a canvas.

const DASHES = [[], [7, 3], [2, 2.5], [9, 3, 2, 3], [4, 2], [1.5, 4]]; // so that lines differ without their colours
const [LEFT, BELOW] = [54, 14]; // pixels beside the lines, for the numbers

/** Steps of 1, 2 or 5 times a power of ten, about `count` of them over a span. */
function niceStep(span, count) {
  const size = 10 ** Math.floor(Math.log10(span / count));
  return size * [1, 2, 5, 10].find((x) => x * size * count >= span);
}

function ticks(low, high, count) {
  const step = niceStep(high - low, count);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, i) => (first + i) * step);
}

const told = (x) => (x !== 0 && Math.abs(x) < 0.005 ? x.toExponential(0) : String(Number(x.toPrecision(3))));

class LineChart {
  /** `least` is the smallest span of the scale: what is smaller, as a rounding error, stays a flat line. */
  constructor(canvas, names, { span, least }) {
    Object.assign(this, { canvas, names, span, least, rows: [], title: canvas.getAttribute("aria-label") });
    const legend = canvas.closest("figure").querySelector("figcaption .legend");
    const sample = (i) => `<svg viewBox="0 0 24 4" class="line${i % 6}"><path d="M0 2H24" stroke-dasharray="${DASHES[i % 6].join(" ")}"/></svg>`;
    legend.innerHTML = names.map((name, i) => `<span>${sample(i)}${name}</span>`).join(" ");
  }
  add(time, values) {
    const last = this.rows[this.rows.length - 1];
    if (last && time < last[0]) this.rows = [];
    if (last && this.rows.length && time < last[0] + this.span / 240) return;
    this.rows.push([time, ...values]);
    while (this.rows[0][0] < time - this.span) this.rows.shift();
  }
  /** The latest numbers in words, for who does not see the lines. */
  tell() {
    const last = this.rows[this.rows.length - 1];
    if (last) this.canvas.setAttribute("aria-label", `${this.title}: ${this.names.map((name, i) => `${name} ${told(last[i + 1])}`).join(", ")}`);
  }
  draw() {
    const { canvas, rows, names } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return; // folded away
    if (canvas.width !== Math.round(width * ratio)) [canvas.width, canvas.height] = [width * ratio, height * ratio].map(Math.round);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    if (rows.length < 2) return;
    const style = getComputedStyle(canvas);
    const values = rows.flatMap((row) => row.slice(1));
    let [low, high] = [Math.min(...values), Math.max(...values)];
    const middle = 0.5 * (low + high);
    const half = Math.max(0.55 * (high - low), 0.5 * this.least, 1e-12);
    [low, high] = [middle - half, middle + half];
    const end = rows[rows.length - 1][0];
    const x = (t) => LEFT + (width - LEFT) * (1 - (end - t) / this.span);
    const y = (value) => height - BELOW - (height - BELOW - 4) * ((value - low) / (high - low));
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = style.getPropertyValue("--quiet");
    pen.strokeStyle = style.getPropertyValue("--edge");
    const rule = (from, to) => {
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.stroke();
    };
    pen.textAlign = "right";
    for (const value of ticks(low, high, 3)) {
      rule([LEFT, y(value)], [width, y(value)]);
      pen.fillText(told(value), LEFT - 6, y(value) + 4);
    }
    pen.textAlign = "center";
    for (const time of ticks(end - this.span, end, 5).filter((each) => each >= 0)) {
      rule([x(time), height - BELOW], [x(time), height - BELOW + 3]);
      if (x(time) < width - 12) pen.fillText(`${told(time)} s`, x(time), height - 1);
    }
    pen.lineWidth = 1.6;
    names.forEach((_, i) => {
      pen.strokeStyle = style.getPropertyValue(`--line${i % 6}`);
      pen.setLineDash(DASHES[i % 6]);
      pen.beginPath();
      for (const row of rows) pen.lineTo(x(row[0]), y(row[i + 1]));
      pen.stroke();
    });
    pen.setLineDash([]);
  }
}
