"use strict";
// A small chart of the last seconds: one line a name, its own scale, drawn on a canvas.

const told = (x) => (x !== 0 && Math.abs(x) < 0.005 ? x.toExponential(0) : String(Number(x.toPrecision(2))));

class LineChart {
  constructor(canvas, names, span) {
    Object.assign(this, { canvas, names, span, rows: [] });
    const legend = canvas.parentElement.querySelector("figcaption .legend");
    legend.innerHTML = names.map((name, i) => `<span class="line${i % 6}">${name}</span>`).join(" ");
  }
  add(time, values) {
    const last = this.rows[this.rows.length - 1];
    if (last && time < last[0]) this.rows = [];
    if (last && this.rows.length && time < last[0] + this.span / 240) return;
    this.rows.push([time, ...values]);
    while (this.rows[0][0] < time - this.span) this.rows.shift();
  }
  draw() {
    const { canvas, rows, names } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) [canvas.width, canvas.height] = [width * ratio, height * ratio].map(Math.round);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    if (rows.length < 2) return;
    const style = getComputedStyle(canvas);
    const values = rows.flatMap((row) => row.slice(1));
    let [low, high] = [Math.min(...values), Math.max(...values)];
    const middle = 0.5 * (low + high);
    const half = Math.max(0.55 * (high - low), 1e-3 * Math.abs(middle), 1e-9);
    [low, high] = [middle - half, middle + half];
    const left = 54;
    const end = rows[rows.length - 1][0];
    const x = (t) => left + (width - left) * (1 - (end - t) / this.span);
    const y = (value) => height - 4 - (height - 8) * ((value - low) / (high - low));
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = style.getPropertyValue("--quiet");
    pen.strokeStyle = style.getPropertyValue("--edge");
    for (const value of [low + 0.1 * half, middle, high - 0.1 * half]) {
      pen.beginPath();
      pen.moveTo(left, y(value));
      pen.lineTo(width, y(value));
      pen.stroke();
      pen.textAlign = "right";
      pen.fillText(told(value), left - 6, y(value) + 4);
    }
    pen.lineWidth = 1.6;
    names.forEach((_, i) => {
      pen.strokeStyle = style.getPropertyValue(`--line${i % 6}`);
      pen.beginPath();
      for (const row of rows) pen.lineTo(x(row[0]), y(row[i + 1]));
      pen.stroke();
    });
  }
}
