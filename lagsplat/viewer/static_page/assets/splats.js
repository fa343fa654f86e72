"use strict";
// The Gaussians of the decoder, drawn with WebGL2 by the image model of lagsplat/splat/image_model.py. What a Gaussian
// is at a state, its place and its presence, is worked out on the graphics card from a texture of its constants. How it is
// seen, `FLATTEN`, is told by the view: page/plane.js or page/space.js.

const CORNERS = 6; // of what is drawn for a Gaussian: a hexagon around the ellipse beyond which it is not seen

const VERTEX = `#version 300 es
precision highp float;
uniform highp sampler2D constants;
uniform float q[LATENTS];
uniform vec2 size;      // of the drawn picture [px]
uniform vec2 stretch;   // drawn pixels a pixel of the training resolution
out vec2 away;          // from the middle, in standard deviations
flat out vec4 paint;    // colour, opacity
float number(int k, int i) {
  int at = k * ROW + i / 4;
  return texelFetch(constants, ivec2(at % WIDE, at / WIDE), 0)[i % 4];
}
FLATTEN
void main() {
  int k = gl_VertexID / CORNERS;
  float place[SPACE];
  for (int c = 0; c < SPACE; c++) {
    place[c] = number(k, c);
    for (int i = 0; i < LATENTS; i++) place[c] += q[i] * number(k, SPACE + c * LATENTS + i);
  }
  float squares = 0.0;
  for (int i = 0; i < LATENTS; i++) {
    float w = -number(k, SPACE + SPACE * LATENTS + i);
    for (int j = 0; j <= LATENTS - 1; j++) w += q[j] * number(k, SPACE + (SPACE + 1 + i) * LATENTS + j);
    squares += w * w;
  }
  float opacity = number(k, REST) * exp(-0.5 * squares);
  paint = vec4(number(k, REST + 1), number(k, REST + 2), number(k, REST + 3), opacity);
  vec2 middle;
  vec3 covariance;
  bool drawn = flatten(k, place, middle, covariance);
  covariance *= vec3(stretch.x * stretch.x, stretch.x * stretch.y, stretch.y * stretch.y);
  float xx = covariance.x + 0.3, xy = covariance.y, yy = covariance.z + 0.3;
  float determinant = xx * yy - xy * xy;
  if (!drawn || !(opacity >= 1.0 / 255.0) || !(determinant > 0.0)) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  float angle = float(gl_VertexID % CORNERS) * ${(2 * Math.PI) / CORNERS};
  away = sqrt(2.0 * log(255.0 * opacity)) * ${1.01 / Math.cos(Math.PI / CORNERS)} * vec2(cos(angle), sin(angle));
  vec2 offset = vec2(sqrt(xx) * away.x, (xy * away.x + sqrt(determinant) * away.y) / sqrt(xx));
  vec2 at = (middle * stretch + offset) / size * 2.0 - 1.0;
  gl_Position = vec4(at.x, -at.y, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 away;
flat in vec4 paint;
out vec4 color;
void main() {
  float alpha = min(0.999, paint.a * exp(-0.5 * dot(away, away)));
  if (alpha < 1.0 / 255.0) discard;
  color = vec4(paint.rgb * alpha, alpha);
}`;

const COPY_VERTEX = `#version 300 es
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0);
}`;

const COPY_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D drawn;
in vec2 at;
out vec4 color;
void main() { color = vec4(clamp(texture(drawn, at).rgb, 0.0, 1.0), 1.0); }`;

const WIDE = 2048;
const SOFTWARE = /swiftshader|llvmpipe|softpipe|basic render/i;

class Splats {
  /** `view` holds the Gaussians, and tells in which order they are drawn, and where and how each is seen. */
  constructor(canvas, { background, height, width }, view) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser draws no WebGL2, which this page needs. A current Firefox, Chrome, Edge or "
      + "Safari does; in a remote or virtual desktop, hardware acceleration may be switched off.");
    const { constants, count, d, space, rest } = view.gaussians;
    Object.assign(this, { gl, canvas, count, background, height, width, view });
    const row = view.gaussians.row / 4;
    const numbers = { LATENTS: d, SPACE: space, REST: rest, ROW: row, WIDE, CORNERS };
    const names = Object.entries(numbers).map(([name, number]) => `#define ${name} ${number}\n`).join("");
    this.program = this.build(VERTEX.replace("precision", names + "precision").replace("FLATTEN", view.shader), FRAGMENT);
    this.copy = this.build(COPY_VERTEX, COPY_FRAGMENT);
    const rows = Math.ceil((count * row) / WIDE);
    const table = new Float32Array(rows * WIDE * 4);
    table.set(constants);
    this.table = this.texture(gl.RGBA32F, WIDE, rows, gl.FLOAT, table);
    this.kind = this.layerKind();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    this.corners = new Uint32Array(3 * (CORNERS - 2) * count);
    this.resize(Math.max(width, height));
  }
  build(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }
  /** The triangles in the order in which they are drawn, as indices: software draws instances one by one. */
  arrange(order) {
    const { gl, corners } = this;
    let at = 0;
    for (const k of order) {
      for (let c = 2; c < CORNERS; c++) {
        corners[at++] = CORNERS * k;
        corners[at++] = CORNERS * k + c - 1;
        corners[at++] = CORNERS * k + c;
      }
    }
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.DYNAMIC_DRAW);
  }
  /** Format in which layers add up, more precise than bytes, of which many faint ones would show. */
  layerKind() {
    const { gl } = this;
    const debug = gl.getExtension("WEBGL_debug_renderer_info");
    const drawer = gl.getParameter(debug ? debug.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    if (!gl.getExtension("EXT_color_buffer_float")) return [gl.RGBA8, gl.UNSIGNED_BYTE];
    // software spends half its time on turning numbers into halves and back
    if (SOFTWARE.test(drawer) && gl.getExtension("EXT_float_blend")) return [gl.RGBA32F, gl.FLOAT];
    return [gl.RGBA16F, gl.HALF_FLOAT];
  }
  texture(format, width, height, type, data) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, width, height, 0, gl.RGBA, type, data);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    return texture;
  }
  /** Draw with `side` pixels along the longer side, from the next picture on: a resized canvas is blank till then. */
  resize(side) {
    this.side = side;
  }
  prepare(side) {
    const { gl, canvas } = this;
    this.prepared = side;
    const stretch = side / Math.max(this.width, this.height);
    canvas.width = Math.round(this.width * stretch);
    canvas.height = Math.round(this.height * stretch);
    if (this.layer) gl.deleteTexture(this.layer);
    this.layer = this.texture(this.kind[0], canvas.width, canvas.height, this.kind[1], null);
    this.target = this.target || gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.layer, 0);
  }
  draw(q) {
    const { gl, canvas, program } = this;
    if (this.side !== this.prepared) this.prepare(this.side);
    const place = (name) => gl.getUniformLocation(program, name);
    this.arrange(this.view.order(q));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...this.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(program);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.uniform1fv(place("q"), q);
    gl.uniform2f(place("size"), canvas.width, canvas.height);
    gl.uniform2f(place("stretch"), canvas.width / this.width, canvas.height / this.height);
    this.view.tell(gl, place);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawElements(gl.TRIANGLES, this.corners.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.copy);
    gl.bindTexture(gl.TEXTURE_2D, this.layer);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}
