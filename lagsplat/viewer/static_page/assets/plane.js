"use strict";
// How Gaussians of the picture are seen and touched: they are where they are drawn, in the order of their index.

const ON_PLANE = `
bool flatten(int k, float place[SPACE], out vec2 middle, out vec3 covariance) {
  middle = vec2(place[0], place[1]);
  covariance = vec3(number(k, REST + 4), number(k, REST + 5), number(k, REST + 6));
  return true;
}`;

class Plane {
  constructor(gaussians, matter) {
    Object.assign(this, { gaussians, matter, shader: ON_PLANE, looks: 0 });
    const { count } = gaussians;
    this.last = Uint32Array.from({ length: count }, (_, i) => count - 1 - i); // the first one is in front
  }
  /** The Gaussians in the order in which they are drawn. */
  order() {
    return this.last;
  }
  /** What the shader wants to know. */
  tell() {}
  /** Where a place is seen [px], and the other way round. */
  seen(place) {
    return place;
  }
  under(pixel) {
    return pixel;
  }
  /** Pixels a unit of length. */
  scale() {
    return 1;
  }
  grasp(q, pixel, radius) {
    return this.matter.brush(q, pixel, radius);
  }
}
