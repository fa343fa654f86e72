"use strict";
// The learned law, one state at a time: the formulas and the integrator of lagsplat/stage2/numpy_lagrangian.py, line by line.
// Vectors are arrays of numbers, matrices arrays of rows. Velocities are per second, energies in the law's own unit.

const dot = (a, b) => {
  let sum = 0;
  for (let i = 0; i < a.length; i++) sum += a[i] * b[i];
  return sum;
};
const apply = (matrix, x) => matrix.map((row) => dot(row, x));
const applyTransposed = (matrix, x) => {
  const out = new Array(matrix[0].length).fill(0);
  for (let i = 0; i < matrix.length; i++) for (let j = 0; j < out.length; j++) out[j] += matrix[i][j] * x[i];
  return out;
};
const plus = (a, b, factor = 1) => a.map((x, i) => x + factor * b[i]);
const times = (a, b) => a.map((x, i) => x * b[i]);
const sigmoid = (x) => 0.5 * (1 + Math.tanh(0.5 * x));
const softplus = (x) => Math.max(x, 0) + Math.log1p(Math.exp(-Math.abs(x)));

/** Solve `matrix x = right` for a symmetric positive definite matrix, by Cholesky's factor. */
function solve(matrix, right) {
  const n = right.length;
  const lower = matrix.map((row) => row.slice());
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = matrix[i][j];
      for (let k = 0; k < j; k++) sum -= lower[i][k] * lower[j][k];
      lower[i][j] = i === j ? Math.sqrt(sum) : sum / lower[j][j];
    }
  }
  const x = right.slice();
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < i; k++) x[i] -= lower[i][k] * x[k];
    x[i] /= lower[i][i];
  }
  for (let i = n - 1; i >= 0; i--) {
    for (let k = i + 1; k < n; k++) x[i] -= lower[k][i] * x[k];
    x[i] /= lower[i][i];
  }
  return x;
}

/** An input-convex network of two hidden layers at one point. */
class Convex {
  constructor(weights) {
    Object.assign(this, weights);
  }
  hidden(x) {
    const z1 = plus(apply(this.first, x), this.firstBias);
    const z2 = plus(plus(apply(this.second, x), this.secondBias), apply(this.between, z1.map(softplus)));
    return [z1, z2];
  }
  value(x, head) {
    return dot(this.hidden(x)[1].map(softplus), head);
  }
  gradient(x, head) {
    const [z1, z2] = this.hidden(x);
    const g2 = times(z2.map(sigmoid), head);
    const g1 = times(applyTransposed(this.between, g2), z1.map(sigmoid));
    return plus(applyTransposed(this.second, g2), applyTransposed(this.first, g1));
  }
}

/** A symmetric positive definite matrix over the states, constant or with a network: `L E E' L' + floor`. */
class Field {
  constructor({ lower, floor, net }) {
    Object.assign(this, { lower, floor, net, d: lower.length });
  }
  at(q) {
    const { first, firstBias, second, secondBias, third } = this.net;
    const h1 = plus(apply(first, q), firstBias).map(Math.tanh);
    const h2 = plus(apply(second, h1), secondBias).map(Math.tanh);
    return [h1, h2, this.triangle(apply(third, h2), 1)];
  }
  triangle(flat, diagonal) {
    const rows = [];
    for (let i = 0; i < this.d; i++) {
      rows.push([]);
      for (let j = 0; j < this.d; j++) rows[i].push((j <= i ? flat[i * this.d + j] : 0) + (i === j ? diagonal : 0));
    }
    return rows;
  }
  product(q, v) {
    let y = applyTransposed(this.lower, v);
    if (this.net) {
      const e = this.at(q)[2];
      y = apply(e, applyTransposed(e, y));
    }
    return plus(apply(this.lower, y), v, this.floor);
  }
  whole(factor) {
    return factor.map((a, i) => factor.map((b, j) => dot(a, b) + (i === j ? this.floor : 0)));
  }
  /** The matrix and the velocity forces. */
  inertia(q, v) {
    if (!this.net) return [this.whole(this.lower), v.map(() => 0)];
    const [h1, h2, e] = this.at(q);
    const { first, second, third } = this.net;
    const s1 = h1.map((h) => 1 - h * h);
    const s2 = h2.map((h) => 1 - h * h);
    const y = applyTransposed(this.lower, v);
    const p = applyTransposed(e, y);
    const rate = this.triangle(apply(third, times(s2, apply(second, times(s1, apply(first, v))))), 0);
    const change = apply(this.lower, plus(apply(rate, p), apply(e, applyTransposed(rate, y))));
    const outer = [];
    for (let i = 0; i < this.d; i++) for (let j = 0; j < this.d; j++) outer.push(j <= i ? y[i] * p[j] : 0);
    const back = times(applyTransposed(second, times(applyTransposed(third, outer), s2)), s1);
    const factor = this.lower.map((row) => applyTransposed(e, row));
    return [this.whole(factor), plus(applyTransposed(first, back), change, -1)];
  }
}

const fieldOf = (data) => (data.frame ? new PolynomialField(data) : new Field(data));

/** The state that is clipped softly outside a ball, as `polynomials.SoftClip`. */
class SoftClip {
  constructor(q, ball, room) {
    const radius = ball[q.length];
    this.z = q.map((x, i) => x - ball[i]);
    this.r = Math.max(Math.hypot(...this.z), radius);
    const tanh = Math.tanh((this.r - radius) / (room * radius));
    this.slope = 1 - tanh * tanh;
    this.share = (radius * (1 + room * tanh)) / this.r;
    this.first = (this.slope - this.share) / this.r;
    this.second = ((-2 / (room * radius)) * tanh * this.slope - 2 * this.first) / this.r;
    this.s = this.z.map((x, i) => ball[i] + this.share * x);
  }
  /** Slope by the state of a function whose slope by the clipped state is known. */
  pullBack(slope) {
    const along = (this.first / this.r) * dot(slope, this.z);
    return slope.map((x, i) => this.share * x + along * this.z[i]);
  }
  /** First and second derivatives along `q + t v`. */
  move(v) {
    const radial = dot(this.z, v) / this.r;
    const change = this.first * radial;
    const bend = this.second * radial ** 2 + (this.first * (dot(v, v) - radial ** 2)) / this.r;
    return [v.map((x, i) => this.share * x + change * this.z[i]), v.map((x, i) => 2 * change * x + bend * this.z[i])];
  }
}

/** Monomials of the clipped state, as `polynomials.evaluate_monomials`. */
class Monomials {
  constructor({ exponents, ball, room, freeDegree }) {
    Object.assign(this, { exponents, ball, room });
    this.free = exponents.map((row) => row.reduce((x, e) => x + e, 0) <= freeDegree);
  }
  clip(q) {
    return new SoftClip(q, this.ball, this.room);
  }
  /** Values, and a row of slopes for each. */
  at(q) {
    const clip = this.clip(q);
    const power = (x, e) => (e > 0 ? x ** e : 1);
    const product = (row, s, skip) => row.reduce((x, e, i) => (i === skip ? x : x * power(s[i], e)), 1);
    const slope = (row, s, i) => (row[i] ? row[i] * power(s[i], row[i] - 1) * product(row, s, i) : 0);
    const slopes = this.exponents.map((row, k) => {
      const s = this.free[k] ? q : clip.s;
      const own = q.map((_, i) => slope(row, s, i));
      return this.free[k] ? own : clip.pullBack(own);
    });
    return [this.exponents.map((row, k) => product(row, this.free[k] ? q : clip.s, -1)), slopes];
  }
  /** First and second derivatives along `q + t v`. */
  along(q, v) {
    const clip = this.clip(q);
    const [speed, bend] = clip.move(v);
    const rows = this.exponents.map((row) =>
      row.reduce(
        ([value, once, twice], e, i) => {
          const x = clip.s[i];
          const byX = e > 0 ? e * x ** (e - 1) : 0;
          const byXX = e > 1 ? e * (e - 1) * x ** (e - 2) : 0;
          const [own, ownOnce, ownTwice] = [x ** e, byX * speed[i], byXX * speed[i] ** 2 + byX * bend[i]];
          return [value * own, once * own + value * ownOnce, twice * own + 2 * once * ownOnce + value * ownTwice];
        },
        [1, 0, 0],
      ),
    );
    return [rows.map((row) => row[1]), rows.map((row) => row[2])];
  }
}

/** `J' S J + floor` with a frame `J` of polynomials, as `polynomials.PolynomialField`. */
class PolynomialField {
  constructor({ inner, floor, frame }) {
    Object.assign(this, { inner, floor, coefficients: frame.coefficients, d: inner.length });
    this.monomials = new Monomials(frame);
  }
  /** `J` and what each monomial adds to it, with its slopes. */
  frame(q) {
    const [values, slopes] = this.monomials.at(q);
    const grid = inSquare(this.d, (i, j) => this.coefficients.reduce((x, c, k) => x + values[k] * c[i][j], i === j ? 1 : 0));
    return [grid, slopes];
  }
  product(q, v) {
    const [frame] = this.frame(q);
    return plus(applyTransposed(frame, apply(this.inner, apply(frame, v))), v, this.floor);
  }
  /** The matrix and the velocity forces. */
  inertia(q, v) {
    const [frame, slopes] = this.frame(q);
    const spread = this.coefficients.map((c) => apply(c, v));
    const swift = slopes.map((row) => dot(row, v));
    const moved = inSquare(this.d, (i, l) => slopes.reduce((x, row, k) => x + spread[k][i] * row[l], 0));
    const rate = inSquare(this.d, (i, j) => this.coefficients.reduce((x, c, k) => x + c[i][j] * swift[k], 0));
    const turning = moved.map((row, i) => plus(row, rate[i], -1));
    const carried = applyTransposed(frame, apply(this.inner, apply(moved, v)));
    const turned = applyTransposed(turning, apply(this.inner, apply(frame, v)));
    const columns = inSquare(this.d, (i, j) => frame[j][i]).map((column) => apply(this.inner, column));
    const matrix = inSquare(this.d, (i, j) => {
      const sum = columns[j].reduce((x, y, k) => x + frame[k][i] * y, 0);
      return sum + (i === j ? this.floor : 0);
    });
    return [matrix, plus(turned, carried, -1)];
  }
}
const inSquare = (d, entry) => Array.from({ length: d }, (_, i) => Array.from({ length: d }, (__, j) => entry(i, j)));

class Law {
  constructor(data) {
    Object.assign(this, data);
    this.massField = fieldOf(data.mass);
    this.dampingField = fieldOf(data.damping);
    this.convexNet = data.convex && new Convex(data.convex);
    this.volumeNet = data.volume && new Convex(data.volume);
    this.edits = { damping: 1, inertia: 1, stiffness: 1 };
  }
  image(q) {
    const hidden = [];
    let x = q;
    for (const { inner, innerBias, outer, outerBias } of this.blocks) {
      const h = plus(apply(inner, x), innerBias).map(Math.tanh);
      x = plus(plus(x, apply(outer, h)), outerBias);
      hidden.push(h);
    }
    return [x, hidden];
  }
  /** `-grad (k V - u.nu)` with the edit `k` of the stiffness. */
  conservativeForce(q, u) {
    const [x, hidden] = this.image(q);
    const offset = plus(x, this.restImage, -1);
    let slope = plus(apply(this.stiffness, offset), this.restSlope, -1);
    if (this.convexNet) slope = plus(slope, this.convexNet.gradient(x, this.convexNet.head[0]));
    slope = slope.map((s) => s * this.edits.stiffness);
    if (u.length) {
      slope = plus(slope, applyTransposed(this.pressureMap, u), -1);
      if (this.curvature) u.forEach((ui, c) => (slope = plus(slope, apply(this.curvature[c], offset), ui)));
      if (this.volumeNet) {
        const above = u.map((x) => Math.max(x, 0));
        const shares = this.signed ? above.concat(u.map((x) => Math.max(-x, 0))) : u;
        slope = plus(slope, this.volumeNet.gradient(x, applyTransposed(this.volumeNet.head, shares)));
      }
    }
    for (let b = this.blocks.length - 1; b >= 0; b--) {
      const { inner, outer } = this.blocks[b];
      const back = applyTransposed(outer, slope).map((s, i) => s * (1 - hidden[b][i] * hidden[b][i]));
      slope = plus(slope, applyTransposed(inner, back));
    }
    return slope.map((s) => -s);
  }
  /** In internal time units, under the generalised force `load`. */
  acceleration(q, w, u, load) {
    const damping = this.dampingField.product(q, w);
    const force = plus(plus(this.conservativeForce(q, u), load), damping, -this.edits.damping);
    const [mass, velocityForce] = this.massField.inertia(q, w);
    return solve(mass, plus(velocityForce, force, 1 / this.edits.inertia));
  }
  /** State and velocity `dt` seconds later, input and load held. */
  step(q, v, u, load, dt) {
    const pieces = Math.max(1, Math.ceil(dt / this.unit / this.longestStep - 1e-9));
    const h = dt / this.unit / pieces;
    let w = v.map((x) => x * this.unit);
    for (let i = 0; i < pieces; i++) [q, w] = this.advance(q, w, (x, y) => this.acceleration(x, y, u, load), h);
    return [q, w.map((x) => x / this.unit)];
  }
  /** A velocity Verlet step. */
  advance(q, w, accelerate, h) {
    const a = accelerate(q, w);
    const half = plus(w, a, 0.5 * h);
    q = plus(q, half, h);
    return [q, plus(half, accelerate(q, plus(half, a, 0.5 * h)), 0.5 * h)];
  }
  potential(q) {
    const [x] = this.image(q);
    const offset = plus(x, this.restImage, -1);
    let value = 0.5 * dot(offset, apply(this.stiffness, offset));
    if (this.convexNet) {
      const head = this.convexNet.head[0];
      value += this.convexNet.value(x, head) - this.convexNet.value(this.restImage, head) - dot(offset, this.restSlope);
    }
    return this.edits.stiffness * value;
  }
  kinetic(q, v) {
    const w = v.map((x) => x * this.unit);
    return 0.5 * this.edits.inertia * dot(w, this.massField.product(q, w));
  }
  dissipatedPower(q, v) {
    const w = v.map((x) => x * this.unit);
    return (this.edits.damping * dot(w, this.dampingField.product(q, w))) / this.unit;
  }
}

/** Coordinates `x = g(q)` of a law, as `polynomials.PolynomialMap`. */
class PolynomialMap {
  constructor(data) {
    this.coefficients = data.coefficients;
    this.monomials = new Monomials(data);
  }
  add(x, amounts) {
    return amounts.reduce((sum, amount, k) => plus(sum, this.coefficients[k], amount), x);
  }
  /** `g` and its Jacobian matrix. */
  at(q) {
    const [values, slopes] = this.monomials.at(q);
    const entry = (i, l) => slopes.reduce((x, row, k) => x + this.coefficients[k][i] * row[l], i === l ? 1 : 0);
    return [this.add(q, values), inSquare(q.length, entry)];
  }
  /** First and second derivative of `g` along `q + t v`. */
  along(q, v) {
    const [first, second] = this.monomials.along(q, v);
    return [this.add(v, first), this.add(v.map(() => 0), second)];
  }
}

/** A law of polynomial energies, integrated by the Runge-Kutta method. */
class PolynomialLaw extends Law {
  constructor(data) {
    super(data);
    this.map = new PolynomialMap(data.coordinates);
    this.elastic = new Monomials(data.energy.elastic);
    this.pushed = new Monomials(data.energy.pushed);
  }
  conservativeForce(latents, u) {
    const { energy, edits } = this;
    const [q, jacobian] = this.map.at(latents);
    let slope = applyTransposed(this.elastic.at(q)[1], energy.coefficients).map((x) => x * edits.stiffness);
    if (u.length) slope = plus(slope, applyTransposed(this.pushed.at(q)[1], applyTransposed(energy.inputCoefficients, u)), -1);
    return applyTransposed(jacobian, slope).map((x) => -x);
  }
  acceleration(q, w, u, load) {
    const [x, jacobian] = this.map.at(q);
    const [speed, bending] = this.map.along(q, w);
    const [mass, velocityForce] = this.massField.inertia(x, speed);
    const damping = this.dampingField.product(x, speed);
    const inner = plus(plus(velocityForce, damping, -this.edits.damping / this.edits.inertia), apply(mass, bending), -1);
    const force = plus(applyTransposed(jacobian, inner), plus(this.conservativeForce(q, u), load), 1 / this.edits.inertia);
    const columns = inSquare(q.length, (i, j) => jacobian[j][i]);
    const carried = columns.map((column) => apply(mass, column));
    return solve(inSquare(q.length, (i, j) => dot(columns[i], carried[j])), force);
  }
  kinetic(q, v) {
    return super.kinetic(this.map.at(q)[0], this.map.along(q, v)[0]);
  }
  dissipatedPower(q, v) {
    return super.dissipatedPower(this.map.at(q)[0], this.map.along(q, v)[0]);
  }
  potential(latents) {
    const { energy } = this;
    const [q] = this.map.at(latents);
    return this.edits.stiffness * (dot(this.elastic.at(q)[0], energy.coefficients) - energy.atRest);
  }
  advance(q, w, accelerate, h) {
    const stages = [];
    for (const reach of [0, 0.5, 0.5, 1]) {
      const [dq, dw] = stages.length ? stages[stages.length - 1] : [w, w];
      const [x, y] = stages.length ? [plus(q, dq, reach * h), plus(w, dw, reach * h)] : [q, w];
      stages.push([y, accelerate(x, y)]);
    }
    for (const [i, share] of [1, 2, 2, 1].entries()) {
      q = plus(q, stages[i][0], (share * h) / 6);
      w = plus(w, stages[i][1], (share * h) / 6);
    }
    return [q, w];
  }
}
const lawOf = (data) => (data.energy ? new PolynomialLaw(data) : new Law(data));
