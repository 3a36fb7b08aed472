// The section: the strip of ground along a line, seen from its side.
import { $, counted } from './panel.js';
import { cut } from './pick.js';

const FEW = 5000; // echoes of a section whose dots are larger
const FAR = 50; // gap between a stray and all others [m]

// A number as its field allows it, which then shows what is used.
export function held(id) { const e = $(id), v = Number(e.value) || Number(e.defaultValue); e.value = Math.min(Number(e.max), Math.max(Number(e.min), v)); return Number(e.value); }

// The heights that a section shows. Few echoes beyond a gap longer than itself are left out: the rest would be as small as they are far.
function heights(all, length) {
  const z = Float64Array.from(all).sort(), n = z.length, few = n < 20 ? 0 : Math.max(1, n / 100), gap = Math.max(FAR, length); let first = 0, last = n - 1;
  for (let k = 1; k <= few && k < n; k += 1) { if (z[k] - z[k - 1] > gap) first = k; if (z[n - k] - z[n - k - 1] > gap) last = n - 1 - k; }
  return { low: z[first] ?? Infinity, high: z[last] ?? -Infinity, strays: n ? n - 1 - last + first : 0 };
}

export class Section {
  // `page`: state, scenes, relabel, hidden, colour, redraw, show, close.
  constructor(page) {
    Object.assign(this, page);
    const draws = () => this.relabel()?.draws('section'), drawn = () => this.relabel()?.stroke.length && this.relabel().where === 'section';
    $('cut').onpointerdown = (e) => { if (e.button === 0 && this.state.section?.view && draws()) { $('cut').setPointerCapture(e.pointerId); this.relabel().down('section', e.offsetX, e.offsetY); } };
    $('cut').onpointermove = (e) => { if (e.buttons && drawn()) this.relabel().move(e.offsetX, e.offsetY); };
    $('cut').onpointerup = () => { if (drawn()) this.relabel().up(); };
    $('cut').onpointercancel = () => this.relabel()?.cancel();
    $('cut').onclick = (e) => { if (!draws()) this.click(e.offsetX, e.offsetY); };
    $('width').onchange = () => { if (this.state.section) { this.state.section.half = held('width') / 2; this.redraw(); } };
    $('exaggeration').onchange = this.redraw; $('close-profile').onclick = this.close;
  }

  // Of two runs the same strip of ground, at one scale: side by side, or one above the other where that shows them larger.
  measure() {
    const c = $('cut'), g = c.getContext('2d'), line = this.state.section, scenes = this.scenes(), n = scenes.length; line.stale = false;
    const cuts = scenes.map((s) => cut(s.nodes.values(), line.A, line.B, line.half, this.hidden)), { length } = cuts[0];
    const { low, high, strays } = heights(cuts.flatMap(({ echoes }) => echoes.map((e) => e.z)), length);
    line.echoes = []; line.picture = line.view = null;
    $('cut-says').textContent = low > high ? 'no echo lies here' : `${cuts.map(({ echoes }, of) => `${n > 1 ? `${scenes[of].run}: ` : ''}${counted(echoes.length)}`).join('; ')}; ${length.toFixed(1)} m long, ${(high - low).toFixed(1)} m high${strays ? `; ${counted(strays)} far above or below ${strays === 1 ? 'is' : 'are'} left out` : ''}${scenes.some((s) => s.short) ? '; thinned: along a shorter or narrower one all are drawn' : ''}`;
    c.width = c.clientWidth; c.height = c.clientHeight; // which the words have left
    if (low > high) return;
    const over = held('exaggeration'), scale = (w, h) => Math.min((w - 20) / length, (h - 16) / Math.max((high - low) * over, 1));
    const beside = scale(c.width / n, c.height) > scale(c.width, c.height / n), w = Math.floor(beside ? c.width / n : c.width), h = Math.floor(beside ? c.height : c.height / n), k = scale(w, h), left = (w - k * length) / 2, bottom = h - 8 - Math.max(0, h - 16 - (high - low) * over * k) / 2;
    const picture = g.createImageData(c.width, c.height), px = new Uint32Array(picture.data.buffer), wide = cuts.reduce((sum, one) => sum + one.echoes.length, 0) < FEW * n ? 3 : 2;
    cuts.forEach(({ echoes }, of) => { for (const e of echoes.filter(({ z }) => z >= low && z <= high)) {
      e.of = of; e.x = left + e.s * k + (beside ? of * w : 0); e.y = bottom - (e.z - low) * k * over + (beside ? 0 : of * h); line.echoes.push(e);
      const v = e.node.marks?.[e.row] ? 0xffb000e8 : this.colour(e), X = Math.round(e.x), Y = Math.round(e.y);
      for (let a = 0; a < wide; a += 1) for (let b = 0; b < wide; b += 1) if (X + a >= 0 && X + a < c.width && Y + b >= 0 && Y + b < c.height) px[(Y + b) * c.width + X + a] = v;
    } });
    line.panes = n > 1 ? scenes.map((s, of) => ({ name: s.run, x: beside ? of * w : 0, y: beside ? 0 : of * h, w, h })) : [];
    line.picture = picture; line.view = { left, k, low, over, bottom }; this.sketch();
  }

  // The section's picture, and over it the runs' names, the echo that was asked for, and what is being drawn.
  sketch() {
    const g = $('cut').getContext('2d'), { section: line, selected } = this.state; g.putImageData(line.picture, 0, 0);
    g.font = '600 12px system-ui, "DejaVu Sans", sans-serif'; g.fillStyle = '#1d2a35'; g.strokeStyle = '#b9c4cb'; g.lineWidth = 1;
    for (const p of line.panes) { g.fillText(p.name, p.x + 6, p.y + 13, p.w - 12); if (p.x || p.y) g.strokeRect(p.x - 0.5, p.y - 0.5, p.w + 9, p.h + 9); }
    const mine = selected && line.echoes.find((e) => e.node === selected.node && e.row === selected.row);
    if (mine) { g.beginPath(); g.arc(mine.x + 1, mine.y + 1, 8, 0, 7); g.strokeStyle = '#c2410c'; g.lineWidth = 2; g.stroke(); }
    this.relabel()?.inSection(g);
  }

  click(x, y) {
    let best = null;
    for (const one of this.state.section?.echoes || []) { const d = (one.x - x) ** 2 + (one.y - y) ** 2; if (d < 100 && (!best || d < best.d)) best = { d, one }; }
    if (best) { const { node, row, s, z, of } = best.one, { A, B } = this.state.section, L = Math.hypot(B[0] - A[0], B[1] - A[1]); this.show(of, { node, row, place: [A[0] + (B[0] - A[0]) * s / L, A[1] + (B[1] - A[1]) * s / L, z] }); }
  }
}
