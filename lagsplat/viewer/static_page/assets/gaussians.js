"use strict";
// The Gaussians that are drawn, as a ray meets them.

const ALPHA_MIN = 1 / 255;

/** Gaussians in `space` dimensions, packed by lagsplat/viewer/static_page/build.py. */
class DrawnGaussians {
  constructor({ constants, count, d, space }) {
    const rest = space + (space + 1 + d) * d;
    const row = 4 * Math.ceil((rest + 4 + (space * (space + 1)) / 2) / 4);
    Object.assign(this, { constants: decoded(constants, Float32Array), count, d, space, rest, row });
  }
  /** One coordinate of the centre of a Gaussian at a state. */
  coordinate(k, axis, q) {
    const at = k * this.row + this.space + axis * this.d;
    let x = this.constants[k * this.row + axis];
    for (let i = 0; i < this.d; i++) x += q[i] * this.constants[at + i];
    return x;
  }
  place(k, q) {
    return Array.from({ length: this.space }, (_, axis) => this.coordinate(k, axis, q));
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
  /** Lower triangle of the covariance, row by row. */
  covariance(k) {
    const at = k * this.row + this.rest + 4;
    return this.constants.subarray(at, at + (this.space * (this.space + 1)) / 2);
  }
}
