"use strict";
// How Gaussians of space are seen and touched by a camera that can be turned about the pivot: the projection of
// lagsplat/splat/projection.py, the ray of lagsplat/forces/ray.py. Lengths are pixels of the film's camera at the pivot.

const NEAR = 0.01;
const MARGIN = 0.3;
const BLUR = 0.3;
const BEHIND = 0.05; // share of its depth by which a Gaussian may be too near
const STOPPED = 0.5; // of the light: the ray has met the Gaussian at which less of it than this is left
const WIDEST = [45, 35]; // degrees of yaw and pitch either way: far from where cameras taught, all is a guess
const [SMALLEST, LARGEST] = [0.6, 8]; // of the zoom

const IN_SPACE = `
uniform mat3 turn;       // its columns are the camera's axes: right, down, ahead
uniform vec3 shift;
uniform vec2 focal;
uniform vec2 principal;
uniform vec2 picture;    // size in pixels of the training resolution
bool flatten(int k, float place[SPACE], out vec2 middle, out vec3 covariance) {
  vec3 seen = vec3(place[0], place[1], place[2]) * turn + shift;
  if (!(seen.z >= ${NEAR})) return false;
  vec2 ahead = seen.xy / seen.z;
  middle = principal + focal * ahead;
  vec2 slack = ${0.5 * MARGIN} * picture;
  vec2 slope = clamp(ahead, -(principal + slack) / focal, (picture - principal + slack) / focal);
  vec3 right = focal.x / seen.z * (turn[0] - slope.x * turn[2]);
  vec3 down = focal.y / seen.z * (turn[1] - slope.y * turn[2]);
  float xx = number(k, REST + 4), xy = number(k, REST + 5), yy = number(k, REST + 6);
  float xz = number(k, REST + 7), yz = number(k, REST + 8), zz = number(k, REST + 9);
  mat3 spread = mat3(xx, xy, xz, xy, yy, yz, xz, yz, zz);
  covariance = vec3(dot(right, spread * right), dot(right, spread * down), dot(down, spread * down));
  return true;
}`;

const product = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const within = (x, low, high) => Math.min(Math.max(x, low), high);

class Space {
  constructor(gaussians, matter, { camera, height, width }) {
    Object.assign(this, { gaussians, matter, lens: camera.lens, picture: [width, height], shader: IN_SPACE, looks: 0 });
    this.object = [0, 0, camera.depth];
    this.depth = new Depth(gaussians.count);
    this.front();
  }
  /** The film's own camera. */
  front() {
    this.look(0, 0, 1);
  }
  /** A camera moved right and up around the pivot by angles in degrees, with `zoom` times the focal length. */
  look(yaw, pitch, zoom) {
    const [fx, fy, cx, cy] = this.lens;
    Object.assign(this, { yaw: within(yaw, -WIDEST[0], WIDEST[0]), pitch: within(pitch, -WIDEST[1], WIDEST[1]) });
    this.zoom = within(zoom, SMALLEST, LARGEST);
    const [a, b] = [this.yaw, this.pitch].map((angle) => (angle * Math.PI) / 180);
    const ahead = [-Math.sin(a) * Math.cos(b), Math.sin(b), Math.cos(a) * Math.cos(b)];
    const right = [Math.cos(a), 0, Math.sin(a)];
    const down = [0, 1, 2].map((i) => ahead[(i + 1) % 3] * right[(i + 2) % 3] - ahead[(i + 2) % 3] * right[(i + 1) % 3]);
    this.axes = [right, down, ahead];
    const position = [0, 1, 2].map((i) => (i === 2 ? fx : 0) - fx * ahead[i]);
    this.shift = this.axes.map((axis) => -product(axis, position));
    // about the principal point, which so keeps what it shows
    Object.assign(this, { focal: [fx * this.zoom, fy * this.zoom], principal: [cx, cy] });
    this.looks++;
  }
  tell(gl, place) {
    gl.uniformMatrix3fv(place("turn"), false, this.axes.flat());
    gl.uniform3fv(place("shift"), this.shift);
    gl.uniform2fv(place("focal"), this.focal);
    gl.uniform2fv(place("principal"), this.principal);
    gl.uniform2fv(place("picture"), this.picture);
  }
  inside(place) {
    return this.axes.map((axis, c) => product(axis, place) + this.shift[c]);
  }
  seen(place) {
    const [x, y, z] = this.inside(place);
    return [this.principal[0] + (this.focal[0] * x) / z, this.principal[1] + (this.focal[1] * y) / z];
  }
  scale(place) {
    return this.focal[0] / this.inside(place)[2];
  }
  /** What is seen in a pixel of the plane through `place` parallel to the image; the object's, unless told. */
  under(pixel, place = this.object) {
    return this.ahead(pixel, this.inside(place)[2]);
  }
  ahead(pixel, depth) {
    const inside = [0, 1].map((c) => (depth * (pixel[c] - this.principal[c])) / this.focal[c]).concat(depth);
    const away = inside.map((x, c) => x - this.shift[c]);
    return [0, 1, 2].map((i) => this.axes.reduce((sum, axis, c) => sum + axis[i] * away[c], 0));
  }
  /** The Gaussians in the order in which they are drawn: the nearest last. */
  order(q) {
    const { gaussians, depth } = this;
    for (let k = 0; k < gaussians.count; k++) {
      let deep = this.shift[2];
      for (let c = 0; c < 3; c++) deep += this.axes[2][c] * gaussians.coordinate(k, c, q);
      depth.depth[k] = deep >= NEAR ? deep : Infinity;
    }
    return depth.sort();
  }
  /** What the ray through a pixel meets first: a Gaussian and how deep it is, or null. */
  cast(q, pixel) {
    const met = [];
    for (let k = 0; k < this.gaussians.count; k++) {
      const inside = this.inside(this.gaussians.place(k, q));
      const alpha = inside[2] >= NEAR ? this.alpha(k, q, inside, pixel) : 0;
      if (alpha >= ALPHA_MIN) met.push({ k, depth: inside[2], alpha });
    }
    met.sort((a, b) => a.depth - b.depth);
    let left = 1;
    for (const each of met) {
      left *= 1 - each.alpha;
      if (left < STOPPED) return each;
    }
    return null;
  }
  /** How much a Gaussian stops of the light to a pixel. */
  alpha(k, q, [x, y, z], pixel) {
    const slopes = [x / z, y / z].map((slope, c) => {
      const slack = 0.5 * MARGIN * this.picture[c];
      return within(slope, -(this.principal[c] + slack) / this.focal[c], (this.picture[c] - this.principal[c] + slack) / this.focal[c]);
    });
    const rows = slopes.map((slope, c) => this.axes[c].map((x, i) => (this.focal[c] / z) * (x - slope * this.axes[2][i])));
    const [a, b, c, d, e, f] = this.gaussians.covariance(k);
    const [right, down] = rows.map(([x, y, z]) => [a * x + b * y + d * z, b * x + c * y + e * z, d * x + e * y + f * z]);
    const [xx, xy, yy] = [product(rows[0], right) + BLUR, product(rows[0], down), product(rows[1], down) + BLUR];
    const [dx, dy] = [x / z, y / z].map((slope, c) => pixel[c] - this.principal[c] - this.focal[c] * slope);
    const sigma = (0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy)) / (xx * yy - xy * xy);
    return Math.min(0.999, this.gaussians.presence(k, q) * Math.exp(-sigma));
  }
  /** How deep a ray touches matter, unless a Gaussian at `depth` hides it, after lagsplat/forces/ray.py. */
  depthOfMatter(q, pixel, depth) {
    const slopes = [0, 1].map((c) => (pixel[c] - this.principal[c]) / this.focal[c]);
    const touched = this.matter.carry(q).map((place) => this.inside(place))
      .filter(([x, y, z]) => z > 0 && z <= (1 + BEHIND) * depth && Math.hypot(x - z * slopes[0], y - z * slopes[1]) <= 1);
    return touched.reduce((least, [, , z]) => Math.min(least, z), touched.length ? Infinity : depth);
  }
  /** Take hold of what is seen in a pixel; null where no matter is, so that the view is turned. */
  grasp(q, pixel, radius) {
    const met = this.cast(q, pixel);
    const grip = met && this.matter.brush(q, this.ahead(pixel, this.depthOfMatter(q, pixel, met.depth)), radius);
    return grip && !grip.isBackground ? grip : null;
  }
}

/** The view that a run asks for. */
const viewOf = ({ splats, matter }) => new (splats.camera ? Space : Plane)(new DrawnGaussians(splats), new Matter(matter), splats);
