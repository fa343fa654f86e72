"use strict";
// What a drag takes hold of, and where the recording ends: lagsplat/forces/grip.py and lagsplat/viewer/coverage.py.

const ALPHA_MIN = 1 / 255;

/** The Gaussians as the hand feels them; `constants` in the order that lagsplat/viewer/page.py packs. */
class Matter {
  constructor({ constants, count, d }) {
    Object.assign(this, { constants, count, d, row: 4 * Math.ceil((2 + (3 + d) * d + 7) / 4) });
  }
  place(k, q) {
    const { constants: c, d } = this;
    const at = k * this.row;
    let [x, y] = [c[at], c[at + 1]];
    for (let i = 0; i < d; i++) {
      x += q[i] * c[at + 2 + i];
      y += q[i] * c[at + 2 + d + i];
    }
    return [x, y];
  }
  presence(k, q) {
    const { constants: c, d } = this;
    const at = k * this.row;
    let squares = 0;
    for (let i = 0; i < d; i++) {
      let w = -c[at + 2 + 2 * d + i];
      for (let j = 0; j < d; j++) w += q[j] * c[at + 2 + (3 + i) * d + j];
      squares += w * w;
    }
    return c[at + 2 + (3 + d) * d] * Math.exp(-0.5 * squares);
  }
  /** Take hold of what is present around `at` [px]: a grip with its constant Jacobian, or null on nothing. */
  grasp(q, at, radius) {
    const [jx, jy] = [new Array(this.d).fill(0), new Array(this.d).fill(0)];
    let total = 0;
    for (let k = 0; k < this.count; k++) {
      const [x, y] = this.place(k, q);
      const distance = (x - at[0]) ** 2 + (y - at[1]) ** 2;
      const weight = this.presence(k, q) * Math.exp((-0.5 * distance) / radius ** 2);
      total += weight;
      for (let i = 0; i < this.d; i++) {
        jx[i] += weight * this.constants[k * this.row + 2 + i];
        jy[i] += weight * this.constants[k * this.row + 2 + this.d + i];
      }
    }
    if (!(total >= ALPHA_MIN)) return null;
    const jacobian = [jx.map((x) => x / total), jy.map((y) => y / total)];
    return { jacobian, at: at.slice(), clicked: q.slice(), force: [0, 0] };
  }
}

/** The generalised force of a grip. */
const loadOf = (grip, d) =>
  grip
    ? grip.jacobian[0].map((x, i) => x * grip.force[0] + grip.jacobian[1][i] * grip.force[1])
    : new Array(d).fill(0);

/** Where the matter of a grip is at a state [px]. */
const placeOf = (grip, q) =>
  [0, 1].map((c) => grip.at[c] + grip.jacobian[c].reduce((sum, x, i) => sum + x * (q[i] - grip.clicked[i]), 0));

/** How far a state is from all that the recording covered: beyond 1 it never was there. */
function uncovered(q, { points, root, radius }) {
  const at = root[0].map((_, j) => q.reduce((sum, x, i) => sum + x * root[i][j], 0));
  let least = Infinity;
  for (const point of points) {
    let squares = 0;
    for (let i = 0; i < at.length; i++) squares += (at[i] - point[i]) ** 2;
    least = Math.min(least, squares);
  }
  return Math.sqrt(least) / radius;
}
