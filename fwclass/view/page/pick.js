// The echo under a pixel, and the echoes of a section; boxes are walked before the echoes in them.
import { project } from './camera.js';
import { placeOf } from './scene.js';

const REACH = 7; // pixels

export function pick(nodes, m, x, y, width, height, hidden) {
  let best = null;
  for (const n of nodes) {
    if (!near(n, m, x, y, width, height)) continue;
    const w = n.words ??= new Uint16Array(n.bytes.buffer), s = n.step, r = n.rise, [a, b, c] = n.low;
    for (let k = 0; k < n.count; k += 1) {
      const X = a + (w[6 * k] + 0.5) * s, Y = b + (w[6 * k + 1] + 0.5) * s, Z = c + w[6 * k + 2] * r;
      const d = m[3] * X + m[7] * Y + m[11] * Z + m[15];
      if (d <= 0) continue;
      const u = ((m[0] * X + m[4] * Y + m[8] * Z + m[12]) / d + 1) / 2 * width - x; if (u > REACH || u < -REACH) continue;
      const v = (1 - (m[1] * X + m[5] * Y + m[9] * Z + m[13]) / d) / 2 * height - y; if (v > REACH || v < -REACH) continue;
      if (hidden.has(n.bytes[12 * k + 10])) continue;
      const off = u * u + v * v, score = d * (1 + off / 600); // what lies before hides what lies behind, and nearer to the pixel counts
      if (off <= REACH * REACH && (!best || score < best.score)) best = { node: n, row: k, score, place: [X, Y, Z] };
    }
  }
  return best;
}

function near(n, m, x, y, width, height) {
  let l = Infinity, r = -Infinity, t = Infinity, b = -Infinity;
  for (let k = 0; k < 8; k += 1) {
    const [u, v, w] = project(m, [n.low[0] + (k & 1) * n.edge, n.low[1] + ((k >> 1) & 1) * n.edge, n.low[2] + (k >> 2) * n.rise * 65535], width, height);
    if (w <= 0) return true;
    l = Math.min(l, u); r = Math.max(r, u); t = Math.min(t, v); b = Math.max(b, v);
  }
  return x > l - REACH && x < r + REACH && y > t - REACH && y < b + REACH;
}

// Echoes within `half` metres of the line from A to B: along it, height, node and row.
export function cut(nodes, A, B, half, hidden) {
  const L = Math.hypot(B[0] - A[0], B[1] - A[1]), ux = (B[0] - A[0]) / L, uy = (B[1] - A[1]) / L, out = [];
  for (const n of nodes) {
    if (!touches(n.low, [n.low[0] + n.edge, n.low[1] + n.edge], A, B, half)) continue;
    for (let k = 0; k < n.count; k += 1) {
      const [x, y, z] = placeOf(n, k), X = x - A[0], Y = y - A[1], s = X * ux + Y * uy;
      if (s < 0 || s > L || Math.abs(X * uy - Y * ux) > half || hidden.has(n.bytes[12 * k + 10])) continue;
      out.push({ s, z, node: n, row: k });
    }
  }
  return { echoes: out, length: L };
}

export function touches(low, high, A, B, half) {
  const c = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2], r = Math.hypot(high[0] - low[0], high[1] - low[1]) / 2 + half;
  const L2 = (B[0] - A[0]) ** 2 + (B[1] - A[1]) ** 2 || 1, t = Math.max(0, Math.min(1, ((c[0] - A[0]) * (B[0] - A[0]) + (c[1] - A[1]) * (B[1] - A[1])) / L2));
  return Math.hypot(A[0] + t * (B[0] - A[0]) - c[0], A[1] + t * (B[1] - A[1]) - c[1]) <= r;
}
