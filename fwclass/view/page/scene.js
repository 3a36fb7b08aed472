// Which blocks a view wants, and those that are here.
import { Loader, json } from './net.js';
import { eye, FIELD, project } from './camera.js';

const SPACING = 1.4; // pixels between echoes that a level leaves for the next one to fill
export const BUDGET = 2_000_000; // echoes drawn at rest

export class Scene {
  constructor(number, index, changed, failed) {
    Object.assign(this, index);
    this.number = number; this.changed = changed; this.nodes = new Map(); this.asked = new Set(); this.column = ''; this.failures = new Map(); this.early = new Map();
    this.selected = new Map(); this.changes = new Map(); this.epoch = 0;
    this.last = 2 * (this.joined + this.halved) + 1; this.own = 2 * this.joined;
    this.there = this.folder ? new Set(this.folder.nodes) : null; this.told = new Set(this.folder?.told);
    this.loader = new Loader((job, blocks) => this.arrived(job, blocks), (job, fault, status) => {
      if (job.about.refused) { job.about.refused(Object.assign(new Error(fault), { status })); return; }
      this.failures.set(job.about.key, (this.failures.get(job.about.key) || 0) + 1);
      if (this.failures.get(job.about.key) < 3) this.asked.delete(job.about.key);
      failed(fault, status);
    });
    this.places = this.tiles.map(([i, j, echoes, low, high]) => {
      const x = (i - this.west) * this.size, y = (j - this.south) * this.size, z = low - this.origin[2], top = high - this.origin[2];
      return { i: i - this.west, j: j - this.south, echoes, low: [x, y, z], high: [x + this.size, y + this.size, top] };
    });
  }

  static async open(number, changed, failed) { return new Scene(number, await json(`${number}/index.json`), changed, failed); }

  arrived(job, blocks) {
    if (job.about.done) { job.about.done(blocks[0]); return; }
    for (const block of job.about.epoch === this.epoch ? blocks : []) {
      const key = block.node.join('-');
      if (job.about.column) {
        if (job.about.column !== this.column) continue;
        const node = this.nodes.get(key);
        if (node) Object.assign(node, { extra: block.bytes, extraOf: this.column, stale: true }); else if (block.count) this.early.set(key, block.bytes);
      } else if (block.count) {
        const edge = this.size * 2 ** (this.joined - (block.node[0] >> 1));
        if (this.by_) block.low = block.low.map((v, a) => v + this.by_[a]);
        this.nodes.set(key, { ...block, key, edge, level: block.node[0], extra: this.early.get(key) || null, extraOf: this.early.has(key) ? this.column : '', stale: true });
        this.early.delete(key);
        for (const part of this.changes.get(key) || []) this.change(this.nodes.get(key), part);
        for (const part of this.selected.get(key) || []) this.mark(this.nodes.get(key), part);
      }
    }
    this.changed();
  }

  // Count places from another origin, so that one camera looks at two scenes.
  moveTo(origin) {
    const by = this.origin.map((v, a) => v - origin[a]);
    for (const p of this.places) for (let a = 0; a < 3; a += 1) { p.low[a] += by[a]; p.high[a] += by[a]; }
    this.by_ = by; this.origin = origin;
  }

  // Cumulative share of the echoes up to a level.
  share(level) { return 2 ** (level - this.last); }

  want(key, path, rank, column) {
    const full = column ? `${column} ${key}` : key;
    if (this.asked.has(full) || (this.there && !key.startsWith('level-') && !this.there.has(key))) return; // a folder has no file for an empty block
    this.asked.add(full);
    this.loader.ask(`${this.number}/${path}.bin`, rank, { key: full, column, epoch: this.epoch });
  }

  // One block of another kind, asked for before all others.
  block(path, stride) {
    return new Promise((done, refused) => { this.loader.ask(`${this.number}/${path}.bin`, 1e7, { key: path, stride, done, refused }); });
  }

  // Blocks to draw now, the coarsest first; asks for those that lack.
  select(cam, m, width, height, budget, full = null) {
    const k = height / (2 * Math.tan(FIELD / 2)), e = eye(cam), column = this.column;
    const part = column || 'echoes', out = [], ranked = [], wanted = new Set();
    for (const level of this.together) this.want(`level-${level}`, `echoes/level-${level}`, 1e6 - level, '');
    const near = (low, high) => {
      const c = low.map((v, i) => (v + high[i]) / 2), r = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]) / 2;
      const [x, y, w] = project(m, c, width, height), R = (r / Math.max(w, 1e-3)) * k;
      if (w < -r || (w > r && (x < -R || x > width + R || y < -R || y > height + R))) return 0;
      return k / Math.max(Math.hypot(c[0] - e[0], c[1] - e[1], c[2] - e[2]) - r * 0.7, cam.far / 20);
    };
    const first = Math.max(this.own, (this.together.at(-1) ?? -1) + 1);
    for (const tile of this.places) {
      const pixels = near(tile.low, tile.high), within = full && full(tile.low, tile.high);
      if (!pixels && !within) continue;
      for (let level = first; level <= this.last; level += 1) {
        const spacing = (this.size / Math.sqrt(tile.echoes * this.share(level - 1))) * pixels;
        if (!(spacing > SPACING || within)) break;
        const down = (level >> 1) - this.joined, cells = 1 << down, edge = this.size / cells;
        for (let a = 0; a < cells; a += 1) for (let b = 0; b < cells; b += 1) {
          const low = [tile.low[0] + a * edge, tile.low[1] + b * edge, tile.low[2]], high = [low[0] + edge, low[1] + edge, tile.high[2]];
          const cell = cells > 1 ? near(low, high) : pixels, inside = full && full(low, high);
          if (!cell && !inside) continue;
          ranked.push({ inside, rank: inside ? 1e5 - level : (spacing * cell) / (pixels || cell), count: (tile.echoes * (this.share(level) - this.share(level === first ? this.together.at(-1) ?? -Infinity : level - 1))) / cells ** 2, key: `${level}-${(tile.i << down) + a}-${(tile.j << down) + b}` });
        }
      }
    }
    ranked.sort((a, b) => b.rank - a.rank);
    let sum = 0;
    this.short = false; // echoes of the section are left out
    for (const r of ranked) {
      if ((sum += r.count) > budget) { this.short = Boolean(r.inside); break; }
      wanted.add(r.key); this.want(r.key, `echoes/${r.key}`, r.rank, '');
    }
    for (const gone of this.loader.keep((job) => job.rank >= 1e5 || wanted.has(job.about.key.split(' ').at(-1)) || job.about.key.includes('level-'))) this.asked.delete(gone.about.key);
    for (const node of this.nodes.values()) {
      if (!wanted.has(node.key) && !this.together.includes(node.level)) continue;
      const high = [node.low[0] + node.edge, node.low[1] + node.edge, node.low[2] + node.rise * 65535];
      if (!near(node.low, high) && !full?.(node.low, high)) continue;
      out.push(node);
    }
    if (column) {
      for (const level of this.together) if (this.asked.has(`level-${level}`)) this.want(`level-${level}`, `${part}/level-${level}`, 1e6 - level, column);
      for (const n of out) if (!this.together.includes(n.level) && n.extraOf !== column) this.want(n.key, `${part}/${n.key}`, 1, column);
    }
    this.forget(wanted);
    return out.sort((a, b) => a.level - b.level);
  }

  // Blocks that were not wanted for long make room.
  forget(wanted) {
    let held = 0;
    for (const n of this.nodes.values()) held += n.count;
    for (const [key, n] of this.nodes) {
      if (held <= 2 * BUDGET) return;
      if (wanted.has(key) || this.together.includes(n.level)) continue;
      held -= n.count; n.free?.(); this.nodes.delete(key); this.asked.delete(key); this.asked.delete(`${this.column} ${key}`);
    }
  }

  // Rows of blocks that are selected; those of blocks that are not here wait for them.
  choose(blocks) {
    for (const key of this.selected.keys()) { const node = this.nodes.get(key); if (node) Object.assign(node, { marks: null, stale: true }); }
    this.selected.clear();
    for (const b of blocks) this.keep(this.selected, b, (node) => this.mark(node, b));
    this.changed();
  }

  mark(node, { rows }) { node.marks ??= new Uint8Array(node.count); for (const k of rows) node.marks[k] = 1; node.stale = true; }

  // Classes that rows of blocks have by now.
  correct(blocks) {
    for (const b of blocks) this.keep(this.changes, b, (node) => this.change(node, b));
    if (this.column === 'corrected') for (const level of this.together) this.asked.delete(`corrected level-${level}`);
    this.changed();
  }

  change(node, { key, rows, values }) {
    rows.forEach((row, k) => { if (row < node.count) node.bytes[12 * row + 10] = values[k]; });
    node.stale = node.changed = true;
    if (this.column === 'corrected') { node.extraOf = ''; this.asked.delete(`corrected ${key}`); }
  }

  keep(kept, block, use) {
    if (kept.has(block.key)) kept.get(block.key).push(block); else kept.set(block.key, [block]);
    const node = this.nodes.get(block.key);
    if (node) use(node);
  }

  // All blocks once more.
  anew() {
    for (const n of this.nodes.values()) n.free?.();
    for (const held of [this.nodes, this.asked, this.early, this.changes]) held.clear();
    this.epoch += 1; this.loader.keep(() => false); this.changed();
  }

  by(column) {
    for (const key of [...this.asked]) if (key.includes(' ')) this.asked.delete(key);
    for (const n of this.nodes.values()) Object.assign(n, { extra: null, extraOf: '', stale: true }); // until the new ones are here
    this.column = column; this.early.clear(); this.changed();
  }
}

// Place of an echo of a node, relative to the scene's origin [m].
export function placeOf(node, k) {
  const w = node.words ??= new Uint16Array(node.bytes.buffer);
  return [node.low[0] + (w[6 * k] + 0.5) * node.step, node.low[1] + (w[6 * k + 1] + 0.5) * node.step, node.low[2] + w[6 * k + 2] * node.rise];
}
