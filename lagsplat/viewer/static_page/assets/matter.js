"use strict";
// The matter that is pushed: material points of bodies whose poses are polynomials of the state, after
// lagsplat/matter/body_motion.py and lagsplat/forces/grasp.py. Lengths are pixels of the training resolution.

/** Numbers that lagsplat/viewer/static_page/build.py packs as base64, in an array of a type such as `Float32Array`. */
const decoded = (text, Numbers) => new Numbers(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);

const LEAST_SPREAD = 1e-3; // variance of points across a line or a plane, on which a mean cannot be moved
const matrixProduct = (a, b) => a.map((row) => applyTransposed(b, row));
const skewOf = ([x, y, z]) => [[0, -z, y], [z, 0, -x], [-y, x, 0]];
const turnInPlane = (w) => [[Math.cos(w), -Math.sin(w)], [Math.sin(w), Math.cos(w)]];

/** `I + first W + second W W` with the generator `W` of the rotation vector `w`. */
function rotationSeries(w, first, second) {
  const skew = skewOf(w);
  const square = matrixProduct(skew, skew);
  return inSquare(3, (i, j) => (i === j ? 1 : 0) + first * skew[i][j] + second * square[i][j]);
}
/** The largest eigenvalue of a covariance, by powers of it: squaring it ten times leaves no other one. */
function largestEigenvalue(covariance) {
  const trace = (a) => a.reduce((sum, row, i) => sum + row[i], 0);
  let [power, scale] = [covariance, trace(covariance)];
  if (!(scale > 0)) return 0;
  for (let n = 0; n < 10; n++) {
    power = matrixProduct(power, power);
    const size = trace(power);
    power = power.map((row) => row.map((x) => x / size));
  }
  return trace(matrixProduct(power, covariance));
}
const angleOf = (w) => Math.max(Math.hypot(...w), 1e-6);
const bend = (angle) => (2 * Math.sin(0.5 * angle) ** 2) / angle ** 2; // (1 - cos) / angle^2

/** The rotation by `w`: an angle clockwise as seen in the image, or a vector in space. */
function turnBy(w) {
  if (w.length === 1) return turnInPlane(w[0]);
  const angle = angleOf(w);
  return rotationSeries(w, Math.sin(angle) / angle, bend(angle));
}
/** Derivatives of that rotation by each number of `w`. */
function differentiateTurn(w) {
  if (w.length === 1) return [turnInPlane(w[0] + 0.5 * Math.PI)];
  const [angle, turn] = [angleOf(w), turnBy(w)];
  const right = rotationSeries(w, -bend(angle), (angle - Math.sin(angle)) / angle ** 3);
  return w.map((_, k) => matrixProduct(turn, skewOf(right.map((row) => row[k]))));
}

/** How the points of one body move: from `x` to `x + size A(q) b(x)`. */
class BodyMotion {
  constructor({ center, size, state, coefficients, deviations, place }) {
    Object.assign(this, { center, size, coefficients, deviations, space: center.length });
    this.state = new Monomials(state);
    this.place = place && new Monomials(place);
  }
  /** The same bodies, with each deviation of one of them added to its coefficients. */
  static listDeviated(bodies) {
    return bodies.flatMap((body, i) =>
      body.deviations.map((deviation) => {
        const coefficients = body.coefficients.map((row, k) => plus(row, deviation[k]));
        const other = Object.assign(Object.create(BodyMotion.prototype), body, { coefficients });
        return bodies.map((each, j) => (i === j ? other : each));
      })
    );
  }
  /** What `A` multiplies at a point. */
  basis(point) {
    const relative = point.map((x, i) => (x - this.center[i]) / this.size);
    return this.place ? this.place.at(relative)[0] : relative.concat(1);
  }
  /** `size A`, a row for each axis. */
  displace(q) {
    const pose = applyTransposed(this.coefficients, this.state.at(q)[0]);
    if (this.place) return this.rows(pose);
    const turn = turnBy(pose.slice(this.space));
    return turn.map((row, i) => row.map((x, j) => this.size * (x - (i === j ? 1 : 0))).concat(this.size * pose[i]));
  }
  /** Derivatives of `displace` by each coordinate of the state. */
  differentiate(q) {
    const [values, slopes] = this.state.at(q);
    const [pose, n] = [applyTransposed(this.coefficients, values), this.space];
    const turns = this.place ? [] : differentiateTurn(pose.slice(n));
    return q.map((_, l) => {
      const rate = applyTransposed(this.coefficients, slopes.map((row) => row[l]));
      if (this.place) return this.rows(rate);
      const turned = inSquare(n, (i, j) => turns.reduce((sum, turn, k) => sum + turn[i][j] * rate[n + k], 0));
      return turned.map((row, i) => row.concat(rate[i]).map((x) => this.size * x));
    });
  }
  rows(pose) {
    const wide = pose.length / this.space;
    return Array.from({ length: this.space }, (_, i) => pose.slice(i * wide, (i + 1) * wide).map((x) => this.size * x));
  }
}

/** Material points, the body of each, and how the bodies move. */
class Matter {
  constructor({ points, body, bodies }) {
    this.bodies = bodies.map((each) => new BodyMotion(each));
    const [flat, n] = [decoded(points, Float64Array), this.bodies[0].space];
    this.points = body.map((_, k) => Array.from(flat.subarray(k * n, (k + 1) * n)));
    this.body = body;
    this.bases = this.points.map((point, k) => this.bodies[body[k]].basis(point));
    this.all = body.map((_, k) => k);
  }
  /** Places of the chosen points at a state. */
  carry(q, chosen = this.all) {
    const moves = this.bodies.map((body) => body.displace(q));
    return chosen.map((k) => plus(this.points[k], apply(moves[this.body[k]], this.bases[k])));
  }
  /** Motion of the chosen points at a rate of the state. */
  rates(q, rate, chosen) {
    const moves = this.bodies.map((body) => {
      const slopes = body.differentiate(q);
      return slopes[0].map((row, i) => row.map((_, j) => slopes.reduce((sum, slope, l) => sum + rate[l] * slope[i][j], 0)));
    });
    return chosen.map((k) => apply(moves[this.body[k]], this.bases[k]));
  }
  /** Take hold of what is at the place `at`: of the body whose point is nearest, if that is within `radius`, or of the
   * background, with the weights of `follow_places` in lagsplat/forces/grasp.py. */
  brush(q, at, radius) {
    const away = this.carry(q).map((place) => plus(place, at, -1));
    const squares = away.map((x) => dot(x, x));
    const nearest = squares.reduce((best, square, k) => (square < squares[best] ? k : best), 0);
    const isBackground = !(squares[nearest] <= radius ** 2);
    const own = isBackground ? [] : this.all.filter((k) => this.body[k] === this.body[nearest]);
    const brush = own.map((k) => Math.exp((-0.5 * (squares[k] - squares[nearest])) / radius ** 2));
    const mean = (entry) => own.reduce((sum, k, i) => sum + brush[i] * entry(away[k]), 0) / brush.reduce((x, y) => x + y, 0);
    const spread = inSquare(at.length, (i, j) => mean((x) => x[i] * x[j]) + (i === j ? LEAST_SPREAD : 0));
    const tilt = solve(spread, at.map((_, i) => mean((x) => x[i])));
    const weights = own.map((k, i) => brush[i] * (1 - dot(tilt, away[k])));
    const total = weights.reduce((x, y) => x + y, 0);
    const start = this.bases[nearest].map(() => 0);
    const basis = own.reduce((sum, k, i) => plus(sum, this.bases[k], weights[i] / total), start);
    return new Grip(this.bodies, this.body[nearest], basis, q, at, isBackground);
  }
}

/** Matter that is held at a point, where the basis of its body is `basis`, and the force on it. */
class Grip {
  constructor(bodies, number, basis, q, at, isBackground) {
    const others = BodyMotion.listDeviated(bodies).map((each) => each[number]);
    Object.assign(this, { body: bodies[number], others, basis, at: at.slice(), isBackground, force: at.map(() => 0) });
    this.start = plus(at, this.way(q), -1); // where it is at the reference state
  }
  way(q) {
    return apply(this.body.displace(q), this.basis);
  }
  place(q) {
    return plus(this.start, this.way(q));
  }
  /** Motion by each coordinate of the state. */
  slopes(q, body = this.body) {
    return body.differentiate(q).map((slope) => apply(slope, this.basis));
  }
  /** Measure how it answers to a force at a state, as `GraspModel` in lagsplat/viewer/simulation/grasp.py. */
  measure(q, { follow, compliance, leastMobility, farthest, spread, excess, nineInTen, leastMotion }) {
    const slopes = this.slopes(q);
    const across = (rows) => this.at.map((_, i) => rows.map((slope) => slope[i]));
    const mobilityOf = (change, rows) => matrixProduct(across(rows), matrixProduct(change, rows));
    this.mobility = mobilityOf(compliance, slopes);
    this.gain = follow / Math.max(Math.hypot(...this.mobility.flat()), leastMobility);
    this.answer = matrixProduct(compliance, slopes).map((row) => row.map((x) => x / farthest));
    const ofMotion = this.others.map((body, k) => {
      const moved = mobilityOf(compliance, this.slopes(q, body));
      return moved.map((row, i) => plus(row, this.mobility[i], -1 - excess[k]));
    });
    this.spread = spread.map((change) => mobilityOf(change, slopes)).concat(ofMotion);
    Object.assign(this, { nineInTen, leastMotion });
  }
  /** Covariance of the way on which the force takes the matter, over laws that the recording allows as well. */
  covariance() {
    const ways = this.spread.map((each) => apply(each, this.force));
    return inSquare(this.at.length, (i, j) => ways.reduce((sum, way) => sum + way[i] * way[j], 0));
  }
  /** Whether the recording does not determine where the force takes the matter. */
  isUndetermined() {
    const [covariance, way] = [this.covariance(), Math.hypot(...apply(this.mobility, this.force))];
    return Math.sqrt(this.nineInTen * largestEigenvalue(covariance)) > Math.max(way, this.leastMotion);
  }
  /** Take the force of a drag, limited so that the state stays near, times `strength`. */
  pull(drag, strength) {
    const force = drag.map((x) => this.gain * x);
    const factor = strength / Math.max(1, Math.hypot(...apply(this.answer, force)));
    this.force = force.map((x) => factor * x);
  }
  /** Generalised force at a state. */
  load(q) {
    return apply(this.slopes(q), this.force);
  }
}
