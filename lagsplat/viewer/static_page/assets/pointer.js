"use strict";
// What pointers do: on the object they push it; beside it, where there is space, they turn the view, two zoom.

const TURN = 120; // degrees that a drag across the picture turns the view by
const NOTCH = 0.0015; // of the logarithm of the zoom, a pixel that a wheel turns by
const LINE = 16; // pixels

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
