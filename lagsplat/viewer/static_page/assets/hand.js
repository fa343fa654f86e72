"use strict";
// What a drag takes hold of, and where the recording ends: lagsplat/forces/grasp.py and lagsplat/viewer/simulation/history.py.

const ALPHA_MIN = 1 / 255;

/** The Gaussians as the hand feels them, in `space` dimensions; `constants` as lagsplat/viewer/static_page/build.py packs them. */
class Matter {
  constructor({ constants, count, d, space }) {
    const rest = space + (space + 1 + d) * d;
    const row = 4 * Math.ceil((rest + 4 + (space * (space + 1)) / 2) / 4);
    Object.assign(this, { constants, count, d, space, rest, row });
  }
  /** What a rate of the state is to a Gaussian, along one axis. */
  along(k, axis, rate) {
    const at = k * this.row + this.space + axis * this.d;
    let sum = 0;
    for (let i = 0; i < this.d; i++) sum += rate[i] * this.constants[at + i];
    return sum;
  }
  place(k, q) {
    const place = new Array(this.space);
    for (let c = 0; c < this.space; c++) place[c] = this.constants[k * this.row + c] + this.along(k, c, q);
    return place;
  }
  presence(k, q) {
    const { constants, d } = this;
    const at = k * this.row + this.space * (1 + d);
    let squares = 0;
    for (let i = 0; i < d; i++) {
      let w = -constants[at + i];
      for (let j = 0; j < d; j++) w += q[j] * constants[at + (1 + i) * d + j];
      squares += w * w;
    }
    return constants[k * this.row + this.rest] * Math.exp(-0.5 * squares);
  }
  jacobian(k) {
    const at = k * this.row + this.space;
    return Array.from({ length: this.space }, (_, c) => Array.from(this.constants.subarray(at + c * this.d, at + (c + 1) * this.d)));
  }
  /** Lower triangle of the covariance, row by row. */
  covariance(k) {
    const at = k * this.row + this.rest + 4;
    return this.constants.subarray(at, at + (this.space * (this.space + 1)) / 2);
  }
  /** Take hold of what is present around the place `at`: a grip with its constant Jacobian, or null on nothing. */
  brush(q, at, radius) {
    const { constants, d, space, row } = this;
    const sums = new Float64Array(space * d);
    let total = 0;
    for (let k = 0; k < this.count; k++) {
      const distance = this.place(k, q).reduce((sum, x, c) => sum + (x - at[c]) ** 2, 0);
      const weight = this.presence(k, q) * Math.exp((-0.5 * distance) / radius ** 2);
      total += weight;
      for (let i = 0; i < sums.length; i++) sums[i] += weight * constants[k * row + space + i];
    }
    if (!(total >= ALPHA_MIN)) return null;
    return this.grip(q, at, at.map((_, c) => Array.from(sums.subarray(c * d, (c + 1) * d), (x) => x / total)));
  }
  grip(q, at, jacobian) {
    return { jacobian, at: at.slice(), clicked: q.slice(), force: at.map(() => 0) };
  }
}

/** The generalised force of a grip. */
const loadOf = (grip, d) =>
  Array.from({ length: d }, (_, i) => (grip ? grip.jacobian.reduce((sum, row, c) => sum + row[i] * grip.force[c], 0) : 0));

/** Where the matter of a grip is at a state [px]. */
const placeOf = (grip, q) =>
  grip.at.map((x, c) => x + grip.jacobian[c].reduce((sum, j, i) => sum + j * (q[i] - grip.clicked[i]), 0));

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
