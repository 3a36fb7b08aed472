// A camera that turns about a target; z is up. Places are relative to the scene's origin [m].
export const FIELD = 0.8; // rad, from top to bottom
export const start = { target: [0, 0, 0], far: 400, azimuth: -0.5, tilt: 0.9 };

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

export function axes(cam) {
  const s = Math.sin(cam.azimuth), c = Math.cos(cam.azimuth), t = Math.sin(cam.tilt), u = Math.cos(cam.tilt);
  return { right: [c, s, 0], up: [-s * t, c * t, u], back: [s * u, -c * u, t] };
}

export function eye(cam) {
  const { back } = axes(cam);
  return cam.target.map((v, i) => v + cam.far * back[i]);
}

// Column-major matrix of places relative to `about`, which keeps numbers small where single precision counts.
export function matrix(cam, aspect, about = [0, 0, 0]) {
  const { right, up, back } = axes(cam), e = eye(cam).map((v, i) => v - about[i]);
  const f = 1 / Math.tan(FIELD / 2), near = cam.far / 100, far = cam.far * 12;
  const a = (far + near) / (near - far), b = (2 * far * near) / (near - far);
  const row = (v, k) => [v[0] * k, v[1] * k, v[2] * k, -dot(v, e) * k];
  const x = row(right, f / aspect), y = row(up, f), z = row(back, 1);
  return new Float32Array([0, 1, 2, 3].flatMap((i) => [x[i], y[i], z[i] * a + (i === 3 ? b : 0), -z[i]]));
}

// Pixels from the upper left corner, and the depth [m].
export function project(m, p, width, height) {
  const w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
  const x = m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12], y = m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13];
  return [((x / w + 1) / 2) * width, ((1 - y / w) / 2) * height, w];
}

// Where the ray through a pixel meets the height `z`; null where it does not.
export function onHeight(cam, x, y, width, height, z = cam.target[2]) {
  const { right, up, back } = axes(cam), e = eye(cam), h = Math.tan(FIELD / 2);
  const u = ((2 * x) / width - 1) * h * (width / height), v = (1 - (2 * y) / height) * h;
  const d = [0, 1, 2].map((i) => right[i] * u + up[i] * v - back[i]), s = (z - e[2]) / d[2];
  return s > 0 && s < cam.far * 12 ? [e[0] + s * d[0], e[1] + s * d[1], z] : null;
}

// Stand where all points are just seen, with a margin, and turn about the height `z`. The direction stays.
export function fit(cam, points, aspect, z) {
  const { right, up, back } = axes(cam), high = Math.tan(FIELD / 2) * 0.94, wide = high * aspect;
  const most = (along, by) => points.reduce((m, p) => Math.max(m, dot(p, along) + by * dot(p, back)), -Infinity), less = (v) => v.map((x) => -x);
  const [r, l, u, d] = [most(right, wide), most(less(right), wide), most(up, high), most(less(up), high)];
  const place = [(r - l) / 2, (u - d) / 2, Math.max((r + l) / (2 * wide), (u + d) / (2 * high))], e = [0, 1, 2].map((k) => place[0] * right[k] + place[1] * up[k] + place[2] * back[k]);
  cam.far = Math.max(5, (e[2] - z) / back[2]); cam.target = e.map((v, k) => v - cam.far * back[k]);
}
