"use strict";
// What pointers do: on the object they push it; beside it, where there is space, they turn the view, two zoom. What
// keys do: arrows push the object at the place that moves most.

const TURN = 120; // degrees that a drag across the picture turns the view by
const NOTCH = 0.0015; // of the logarithm of the zoom, a pixel that a wheel turns by
const LINE = 16; // pixels
const NUDGE = 0.2; // way of a push by an arrow key over the picture's width
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Number of the place that is nearest to another. */
function nearest(places, at) {
  const away = places.map((place) => Math.hypot(...plus(place, at, -1)));
  return away.indexOf(Math.min(...away));
}

class Pointers {
  constructor({ session, view, picture, run }, asked) {
    Object.assign(this, { session, view, picture, asked, size: [run.splats.width, run.splats.height] });
    this.held = null; // the pointer that pushes
    this.others = new Map(); // those that turn, and where they are on the screen
    const on = (kind, act) => picture.addEventListener(kind, (event) => act.call(this, event));
    on("pointerdown", this.press);
    on("pointermove", this.move);
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) on(kind, this.letGo);
    if (view.look) picture.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.keys = new Set();
    this.lever = nearest(view.matter.carry(run.rest).map((place) => view.seen(place)), run.lever);
    on("keydown", this.keyDown);
    on("keyup", this.keyUp);
    on("blur", () => this.dropKeys());
  }
  keyDown(event) {
    const { session, view, keys } = this;
    if (!(event.key in ARROWS) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (this.held !== null || session.stopped) return;
    keys.add(event.key);
    if (!session.grip && !session.grasp(view.seen(view.matter.carry(session.q, [this.lever])[0]))) return;
    const way = [...keys].map((key) => ARROWS[key]).reduce((sum, arrow) => plus(sum, arrow), [0, 0]);
    const from = view.seen(session.grip.at);
    const to = view.under(plus(from, way, NUDGE * this.size[0]), session.grip.at);
    session.pull(plus(to, view.under(from, session.grip.at), -1));
    session.everHeld = true;
    this.asked(event.timeStamp);
  }
  keyUp(event) {
    if (this.keys.delete(event.key) && !this.keys.size) this.session.release();
  }
  dropKeys() {
    if (this.keys.size) this.session.release();
    this.keys.clear();
  }
  /** Where a pointer is [px of the training resolution]. */
  at(event) {
    const box = this.picture.querySelector("canvas").getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top].map((x, i) => (x / [box.width, box.height][i]) * this.size[i]);
  }
  press(event) {
    const { session, view, others } = this;
    if (this.held !== null || event.button !== 0) return;
    if (!session.stopped && !others.size && session.grasp(this.at(event))) {
      this.held = event.pointerId;
      this.from = view.under(this.at(event), session.grip.at);
      session.everHeld ||= !session.grip.isBackground;
    } else if (view.look) others.set(event.pointerId, [event.clientX, event.clientY]);
    else return;
    this.picture.setPointerCapture(event.pointerId);
    event.preventDefault();
  }
  move(event) {
    const { session, view } = this;
    if (event.pointerId === this.held && session.grip) {
      const to = view.under(this.at(event), session.grip.at);
      session.pull(to.map((x, i) => x - this.from[i]));
      this.asked(event.timeStamp);
    } else if (this.others.has(event.pointerId)) this.turn(event);
  }
  turn({ pointerId, clientX, clientY }) {
    const { view, others } = this;
    const [x, y] = others.get(pointerId);
    const before = others.size === 2 ? this.apart() : 0;
    others.set(pointerId, [clientX, clientY]);
    if (others.size === 2) view.look(view.yaw, view.pitch, (view.zoom * this.apart()) / Math.max(before, 1));
    else {
      const angle = TURN / this.picture.clientWidth;
      view.look(view.yaw - (clientX - x) * angle, view.pitch + (clientY - y) * angle, view.zoom);
    }
  }
  /** Pixels between two pointers on the screen. */
  apart() {
    const [[x0, y0], [x1, y1]] = this.others.values();
    return Math.hypot(x1 - x0, y1 - y0);
  }
  wheel(event) {
    event.preventDefault();
    const { view } = this;
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE;
    view.look(view.yaw, view.pitch, view.zoom * Math.exp(-NOTCH * event.deltaY * (lines ? LINE : 1)));
  }
  letGo(event) {
    this.others.delete(event.pointerId);
    if (event.pointerId !== this.held) return;
    this.held = null;
    this.session.release();
  }
}
