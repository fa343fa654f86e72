"use strict";
// A run that is being pushed, without a picture: the JavaScript of lagsplat/viewer/simulation/session.py.

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

class PageSession {
  constructor(run, law, view) {
    Object.assign(this, { run, law, view, d: run.d, dt: run.dt, speed: 1, strength: 1, radius: run.brush });
    this.u = run.inputs.mean.slice();
    this.following = false;
    this.grip = null;
    this.paused = false;
    this.rest();
  }
  begin(q, v, frame) {
    Object.assign(this, { q, v, frame, grip: null, stopped: false });
    this.books = { hand: 0, inputs: 0, edits: 0, dissipated: 0, began: this.energy().total };
  }
  /** Stand still where the law settles under the mean inputs. */
  rest() {
    this.u = this.run.inputs.mean.slice();
    this.following = false;
    this.begin(this.run.rest.slice(), new Array(this.d).fill(0), null);
    this.time = 0;
  }
  /** Go on in a state of the recording: driven ones as recorded, others from where the recording is farthest from rest. */
  replay() {
    const { recorded, rest, inputs } = this.run;
    this.following = inputs.names.length > 0;
    const away = recorded.states.map((q) => Math.hypot(...q.map((x, i) => x - rest[i])));
    this.toFrame(this.following ? 0 : away.indexOf(Math.max(...away)));
  }
  toFrame(frame) {
    const { states, rates, rows } = this.run.recorded;
    this.u = rows[frame].slice();
    this.begin(states[frame].slice(), rates[frame].slice(), frame);
  }
  energy() {
    const [kinetic, potential] = [this.law.kinetic(this.q, this.v), this.law.potential(this.q)];
    return { kinetic, potential, total: kinetic + potential };
  }
  /** Range of the energy in the recording, and of the state. */
  ranges() {
    const { states, rates } = this.run.recorded;
    const spread = (values) => Math.max(...values) - Math.min(...values);
    const total = states.map((q, n) => this.law.kinetic(q, rates[n]) + this.law.potential(q));
    return { energy: spread(total), state: spread(states.flat()) };
  }
  /** Energy that the books cannot explain: the integrator's own error. */
  unexplained() {
    const { hand, inputs, edits, dissipated, began } = this.books;
    return this.energy().total - began - hand - inputs - edits + dissipated;
  }
  /** Take hold of what the view shows in a pixel; null where that is nothing to hold. */
  grasp(pixel) {
    this.grip = this.view.grasp(this.q, pixel, this.radius);
    this.grip?.measure(this.q, this.run.pull);
    return this.grip;
  }
  /** Hold it with the force of a drag, told as a way of the matter: it keeps size and direction. */
  pull(drag) {
    this.grip?.pull(drag, this.strength);
  }
  release() {
    this.grip = null;
  }
  edit(name, value) {
    const before = this.energy().total;
    this.law.edits[name] = value;
    this.books.edits += this.energy().total - before;
  }
  step() {
    if (this.stopped) return;
    if (this.frame !== null) {
      if (this.following) this.u = this.run.recorded.rows[this.frame].slice();
      this.frame = (this.frame + 1) % this.run.recorded.states.length;
    }
    const [q0, v0] = [this.q, this.v];
    const load = this.grip ? this.grip.load(q0) : new Array(this.d).fill(0);
    const [q, v] = this.law.step(q0, v0, this.u, load, this.dt);
    const far = Math.hypot(...q.map((x, i) => x - this.run.rest[i]));
    if (!v.every(Number.isFinite) || !(far <= this.run.divergence * this.run.reach)) {
      Object.assign(this, { stopped: true, grip: null });
      return;
    }
    this.book(q0, v0, q, v, load);
    Object.assign(this, { q, v, time: this.time + this.dt });
  }
  book(q0, v0, q, v, load) {
    const way = q.map((x, i) => x - q0[i]);
    const work = (force) => force.reduce((sum, f, i) => sum + f * way[i], 0);
    this.books.hand += work(load);
    if (this.u.length) {
      const none = this.u.map(() => 0);
      for (const at of [q0, q]) {
        const driven = this.law.conservativeForce(at, this.u);
        const bare = this.law.conservativeForce(at, none);
        this.books.inputs += 0.5 * work(driven.map((x, i) => x - bare[i]));
      }
    }
    this.books.dissipated += 0.5 * this.dt * (this.law.dissipatedPower(q0, v0) + this.law.dissipatedPower(q, v));
  }
  isBeyond() {
    return !this.stopped && uncovered(this.q, this.run.coverage) > 1;
  }
  /** What must be said of this state, which may be `beyond` the recording, or nothing. */
  banner(beyond = this.isBeyond()) {
    if (this.stopped) return "The motion diverged and the integration stopped. Press Rest, or undo the edits.";
    if (beyond)
      return "Beyond the recording: the camera never saw such a state, and what you see is a guess.";
    if (this.grip?.isUndetermined())
      return "Not determined by this recording: laws that fit it as well take this point elsewhere.";
    return "";
  }
}
