"use strict";
// The order of Gaussians from far to near, anew for each picture: two passes over the halves of their depths' bits.

const HALF = 1 << 16;

class Depth {
  constructor(count) {
    this.depth = new Float32Array(count);
    this.bits = new Uint32Array(this.depth.buffer); // of numbers that are not negative, in the same order as they
    this.order = new Uint32Array(count);
    this.between = new Uint32Array(count);
    this.starts = new Uint32Array(HALF);
  }
  /** Sort by `depth`; of two that are equally deep, the first one is nearer. */
  sort() {
    const { order, between } = this;
    for (let i = 0; i < order.length; i++) order[i] = order.length - 1 - i;
    this.pass(order, between, 0);
    this.pass(between, order, 16);
    return order;
  }
  /** Put indices in falling order of sixteen bits of their depths; equal ones stay as they are. */
  pass(from, to, shift) {
    const { bits, starts } = this;
    starts.fill(0);
    for (let i = 0; i < bits.length; i++) starts[(bits[i] >>> shift) & (HALF - 1)]++;
    for (let half = HALF - 1, sum = 0; half >= 0; half--) {
      const many = starts[half];
      starts[half] = sum;
      sum += many;
    }
    for (const k of from) to[starts[(bits[k] >>> shift) & (HALF - 1)]++] = k;
  }
}
