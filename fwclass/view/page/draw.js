// Points with WebGL2: coloured from what a block has, and shaded where depths jump.
import { matrix } from './camera.js';

const points = (mode) => `#version 300 es
const int mode = ${mode}; uniform mat4 m; uniform vec3 low; uniform vec2 step_; uniform float size; uniform vec2 range; uniform sampler2D palette, ramp;
layout(location=0) in uvec4 p; layout(location=1) in uvec4 q; layout(location=2) in uint e; layout(location=3) in uint k;
flat out vec3 colour;
vec3 ramped(vec3 place) {
  bool none = mode == 1 ? q.w == 255u : mode == 3 ? p.w == 0u : mode == 5 ? e == 255u : false;
  float v = mode == 1 ? float(q.w) / 200.0 : mode == 2 ? place.z : mode == 3 ? float(p.w) * 0.01 - 100.01 : mode == 4 ? float(q.x | (q.y << 8u)) : float(e) / 254.0;
  return none ? vec3(0.75) : texture(ramp, vec2(clamp((v - range.x) / max(range.y - range.x, 1e-6), 0.002, 0.998), 0.5)).rgb;
}
void main() {
  vec3 place = low + vec3((float(p.x) + 0.5) * step_.x, (float(p.y) + 0.5) * step_.x, float(p.z) * step_.y);
  gl_Position = m * vec4(place, 1.0);
  gl_PointSize = clamp(size / gl_Position.w, 1.6, 9.0);
  vec4 mine = texelFetch(palette, ivec2(int(q.z), 0), 0);
  if (mine.a < 0.5) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (mode == 0) colour = mine.rgb; else if (mode == 6) colour = texelFetch(palette, ivec2(int(e), 1), 0).rgb; else colour = ramped(place);
  if (k == 1u) { colour = mix(colour, vec3(0.91, 0.0, 0.69), 0.7); gl_PointSize = max(gl_PointSize, 2.5); }
}`;
const COLOUR = `#version 300 es
precision mediump float; flat in vec3 colour; out vec4 o; void main() { o = vec4(colour, 1.0); }`;
const QUAD = `#version 300 es
void main() { gl_Position = vec4(float((gl_VertexID & 1) * 4 - 1), float((gl_VertexID & 2) * 2 - 1), 0.0, 1.0); }`;
// Eye-dome lighting (Boucheny 2009): a pixel is as dark as its neighbours stand before it, in logarithms of the depth.
const SHADE = `#version 300 es
precision highp float; uniform sampler2D seen, depth; uniform vec2 planes; out vec4 o;
float far(ivec2 at) { float d = texelFetch(depth, at, 0).r; return d >= 1.0 ? 0.0 : log2(2.0 * planes.x * planes.y / (planes.y + planes.x - (2.0 * d - 1.0) * (planes.y - planes.x))); }
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(depth, 0) - 1;
  float d = far(at), sum = 0.0;
  if (d == 0.0) { o = vec4(0.933, 0.945, 0.953, 1.0); return; }
  for (int k = 0; k < 4; k++) {
    ivec2 by = k == 0 ? ivec2(1, 0) : k == 1 ? ivec2(-1, 0) : k == 2 ? ivec2(0, 1) : ivec2(0, -1);
    float n = far(clamp(at + by, ivec2(0), size));
    if (n != 0.0) sum += max(0.0, d - n);
  }
  o = vec4(texelFetch(seen, at, 0).rgb * exp(-sum * 60.0), 1.0);
}`;
const RAMP = [68, 1, 84, 59, 82, 139, 33, 145, 140, 94, 201, 98, 253, 231, 37]; // viridis
export const MODES = { classification: 0, confidence: 1, height: 2, height_above_ground: 3, intensity: 4 };
export const rampColours = RAMP;
const ramp = Array.from({ length: 256 }, (_, v) => { const at = (v / 255) * (RAMP.length / 3 - 1), i = Math.min(Math.floor(at), RAMP.length / 3 - 2); return [0, 1, 2].map((c) => Math.round(RAMP[3 * i + c] + (at - i) * (RAMP[3 * i + 3 + c] - RAMP[3 * i + c]))); });

// The colour of an echo of a node as the shader has it, as a pixel.
export function pixel(look, palette, n, k, z) {
  const b = n.bytes, at = 12 * k, e = n.extra ? n.extra[k] : 255, opaque = (red, green, blue) => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
  let v = NaN;
  switch (look.mode) {
    case 0: case 6: { const p = 4 * (look.mode ? 256 + e : b[at + 10]); return opaque(palette[p], palette[p + 1], palette[p + 2]); }
    case 1: if (b[at + 11] !== 255) v = b[at + 11] / 200; break;
    case 2: v = z; break;
    case 3: if (b[at + 6] | b[at + 7]) v = (b[at + 6] + 256 * b[at + 7]) * 0.01 - 100.01; break;
    case 4: v = b[at + 8] + 256 * b[at + 9]; break;
    default: if (e !== 255) v = e / 254;
  }
  return Number.isNaN(v) ? opaque(191, 191, 191) : opaque(...ramp[Math.round(255 * Math.max(0, Math.min(1, (v - look.low) / Math.max(look.high - look.low, 1e-6))))]);
}

export class Drawing {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext('webgl2', { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error('This browser has no WebGL2, by which the cloud is drawn. Any current Firefox, Chrome, Edge or Safari has it, unless it was turned off.');
    this.palette = new Uint8Array(256 * 2 * 4).fill(255); // classes, then kinds of another column
    this.start();
  }

  start() {
    const gl = this.gl;
    this.points = {}; this.shade = this.program(QUAD, SHADE);
    const texture = (filter) => { const t = gl.createTexture(); gl.bindTexture(gl.TEXTURE_2D, t); for (const [k, v] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, k, v); return t; };
    this.paletteTexture = texture(gl.NEAREST);
    this.rampTexture = texture(gl.LINEAR);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, RAMP.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(RAMP));
    this.seen = texture(gl.NEAREST); this.depth = texture(gl.NEAREST); this.target = gl.createFramebuffer(); this.size = [0, 0];
    this.setPalette();
  }

  program(vertex, fragment) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); gl.attachShader(p, s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(s));
    }
    gl.linkProgram(p);
    const at = {};
    return { p, at: (name) => (at[name] ??= gl.getUniformLocation(p, name)) };
  }

  // Of one way to colour: software GL runs every branch of a shader, whatever a uniform says.
  coloured(mode) { return (this.points[mode] ??= this.program(points(mode), COLOUR)); }

  setPalette() {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.paletteTexture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, this.palette);
  }

  resize() {
    const gl = this.gl, { clientWidth: w, clientHeight: h } = this.canvas;
    if (this.size[0] === w && this.size[1] === h) return;
    this.canvas.width = w; this.canvas.height = h; this.size = [w, h];
    if (!w || !h) return;
    gl.bindTexture(gl.TEXTURE_2D, this.seen); gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, w, h, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindTexture(gl.TEXTURE_2D, this.depth); gl.texImage2D(gl.TEXTURE_2D, 0, gl.DEPTH_COMPONENT24, w, h, 0, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.seen, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depth, 0);
  }

  upload(node) {
    const gl = this.gl;
    if (!node.vao || node.context !== this.points) {
      node.context = this.points; node.vao = gl.createVertexArray(); node.buffer = gl.createBuffer(); node.more = gl.createBuffer(); node.third = gl.createBuffer(); node.changed = true;
      node.free = () => { gl.deleteBuffer(node.buffer); gl.deleteBuffer(node.more); gl.deleteBuffer(node.third); gl.deleteVertexArray(node.vao); };
      gl.bindVertexArray(node.vao); gl.bindBuffer(gl.ARRAY_BUFFER, node.buffer);
      gl.enableVertexAttribArray(0); gl.vertexAttribIPointer(0, 4, gl.UNSIGNED_SHORT, 12, 0);
      gl.enableVertexAttribArray(1); gl.vertexAttribIPointer(1, 4, gl.UNSIGNED_BYTE, 12, 8);
    }
    gl.bindVertexArray(node.vao);
    if (node.changed) { gl.bindBuffer(gl.ARRAY_BUFFER, node.buffer); gl.bufferData(gl.ARRAY_BUFFER, node.bytes, gl.STATIC_DRAW); node.changed = false; }
    if (node.marks) {
      gl.bindBuffer(gl.ARRAY_BUFFER, node.third); gl.bufferData(gl.ARRAY_BUFFER, node.marks, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(3); gl.vertexAttribIPointer(3, 1, gl.UNSIGNED_BYTE, 0, 0);
    }
    if (node.extra) {
      gl.bindBuffer(gl.ARRAY_BUFFER, node.more); gl.bufferData(gl.ARRAY_BUFFER, node.extra, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(2); gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_BYTE, 0, 0);
    }
    node.stale = false;
  }

  // Views side by side: [{nodes}], one camera; returns the echoes drawn. Without `shade` straight to the canvas.
  draw(cam, views, look, shade) {
    const gl = this.gl;
    this.resize();
    const [width, h] = this.size, w = Math.floor(width / views.length);
    if (!w || !h) return 0;
    gl.bindFramebuffer(gl.FRAMEBUFFER, shade ? this.target : null); gl.viewport(0, 0, width, h); gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.933, 0.945, 0.953, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { p, at } = this.coloured(look.mode);
    gl.useProgram(p);
    gl.activeTexture(gl.TEXTURE0); gl.bindTexture(gl.TEXTURE_2D, this.paletteTexture); gl.activeTexture(gl.TEXTURE1); gl.bindTexture(gl.TEXTURE_2D, this.rampTexture);
    gl.uniform1i(at('palette'), 0); gl.uniform1i(at('ramp'), 1);
    let drawn = 0;
    views.forEach(({ nodes }, k) => {
      gl.viewport(k * w, 0, w, h);
      const about = cam.target, m = matrix(cam, w / h, about);
      gl.uniformMatrix4fv(at('m'), false, m);
      const rise = look.mode === 2 ? about[2] : 0;
      gl.uniform2f(at('range'), look.low - rise, look.high - rise);
      for (const n of nodes) {
        if (n.stale || n.context !== this.points) this.upload(n);
        gl.bindVertexArray(n.vao);
        if (!n.marks) { gl.disableVertexAttribArray(3); gl.vertexAttribI4ui(3, 0, 0, 0, 0); }
        if (!n.extra) { gl.disableVertexAttribArray(2); gl.vertexAttribI4ui(2, 255, 0, 0, 0); }
        gl.uniform3f(at('low'), n.low[0] - about[0], n.low[1] - about[1], n.low[2] - about[2]); gl.uniform2f(at('step_'), n.step, n.rise);
        gl.uniform1f(at('size'), (h / 0.845) * look.metres); gl.drawArrays(gl.POINTS, 0, n.count); drawn += n.count;
      }
    });
    gl.bindVertexArray(null);
    if (!shade) { gl.viewport(0, 0, width, h); gl.activeTexture(gl.TEXTURE0); return drawn; }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null); gl.viewport(0, 0, width, h); gl.disable(gl.DEPTH_TEST); gl.useProgram(this.shade.p);
    gl.activeTexture(gl.TEXTURE0); gl.bindTexture(gl.TEXTURE_2D, this.seen); gl.activeTexture(gl.TEXTURE1); gl.bindTexture(gl.TEXTURE_2D, this.depth);
    gl.uniform1i(this.shade.at('seen'), 0); gl.uniform1i(this.shade.at('depth'), 1); gl.uniform2f(this.shade.at('planes'), cam.far / 100, cam.far * 12);
    gl.drawArrays(gl.TRIANGLES, 0, 3); gl.activeTexture(gl.TEXTURE0);
    return drawn;
  }
}
