// Relabelling: what is drawn is selected by the server among all delivered echoes, counted, and only then written.
import { matrix } from './camera.js';
import { json, marked } from './net.js';
import { $, apart, counted } from './panel.js';

const MOST = 1500; // points of a stroke that are sent
const EVERY = 4000; // ms between questions for what others changed
const MODES = ['lasso', 'brush', 'above', 'below'];

export class Relabel {
  // `page`: scene, cam, size, hidden, section, wantSection, leaveTool, using, keyed, redraw, overlay, pressed, failed.
  constructor(page) {
    Object.assign(this, page);
    this.open = false; this.mode = ''; this.stroke = []; this.selection = null; this.rows = this.scene.rows; this.busy = false; this.turn = 0;
    this.done = this.kept('done'); this.undone = this.kept('undone');
    for (const mode of MODES) $(mode).onclick = () => this.use(this.mode === mode ? '' : mode); // a finger has no Esc
    $('apply').onclick = () => this.apply(); $('undo').onclick = () => this.undo(); $('redo').onclick = () => this.redo();
    $('brush-size').oninput = this.overlay; $('give').onchange = () => this.steps();
    for (const id of ['least-sure', 'most-sure', 'lowest', 'highest']) $(id).onchange = () => this.select();
    setInterval(() => { if (!document.hidden && !this.gone) this.follow().catch((e) => this.told(e)); }, EVERY);
  }

  // ---------------------------------------------------------------- the tool
  async toggle() {
    this.open = !this.open; $('relabel').setAttribute('aria-pressed', String(this.open)); $('relabelling').hidden = !this.open;
    this.use(''); this.drop();
    const mine = this.opening = this.open ? {} : null;
    if (!this.open) return;
    this.ready(false); $('relabelling').scrollIntoView({ block: 'nearest' });
    try {
      const about = await json('0/relabel.json', {});
      if (mine !== this.opening) return;
      $('relabel-says').textContent = about.says; this.classes(about.classes); this.ready(true); this.use(mine.mode || 'lasso');
    } catch (e) { if (mine !== this.opening) return; $('relabel-says').textContent = e.message; this.told(e, true); }
  }

  ready(yes) { this.may = yes; for (const e of $('relabelling').querySelectorAll('button, input, select')) if (!e.closest('#again')) e.disabled = !yes; this.steps(); }

  use(mode) {
    if (mode && !this.may) { if (this.opening) this.opening.mode = mode; return; } // typed while the tool opens
    this.mode = mode; this.cancel();
    for (const one of MODES) $(one).setAttribute('aria-pressed', String(one === this.mode));
    if (this.along && !this.section()) this.wantSection(); else if (mode) this.leaveTool();
    this.hint();
    $('brushed').hidden = this.mode !== 'brush'; this.pressed(); this.redraw();
  }

  // What the hand does next, where nothing is selected yet.
  hint() {
    if (!this.open || !this.may || this.last || this.busy) return;
    const along = this.section() ? 'Draw a line in the section, from one side to the other.' : 'Click both ends of a section; then draw a line in it.';
    const words = this.along ? along : !this.mode || this.using() ? '' : this.mode === 'brush' ? 'Draw over echoes.' : 'Draw around echoes.';
    this.count(words && this.keyed() && !this.using() ? `${words} Enter sets a corner, and the last one twice.` : words);
  }

  get along() { return this.mode === 'above' || this.mode === 'below'; }
  get radius() { return Number($('brush-size').value); }
  count(text) { $('count').textContent = text; }

  classes(given) {
    const before = $('give').value;
    $('give').replaceChildren(new Option('choose one', '?'), ...given.map((c) => new Option(`${apart(c.name)} (${c.code})`, c.code)), new Option('no class (0)', '0'), new Option('as delivered', ''));
    if (before) $('give').value = before;
  }

  // ---------------------------------------------------------------- the hand
  draws(where) { return this.open && this.mode && !this.busy && (where === 'section' || !this.along); }
  down(where, x, y) { this.where = where; this.stroke = [[x, y]]; this.overlay(); }
  move(x, y) {
    const last = this.stroke.at(-1);
    if (Math.hypot(x - last[0], y - last[1]) >= 2) this.stroke.push([x, y]);
    this.overlay();
  }

  up() {
    const points = this.corners(this.stroke), radius = this.mode === 'brush' ? this.radius : 0;
    this.cancel();
    if (points.length < (radius ? 1 : 3)) return;
    this.last = { ...this.projection(this.where), points, radius }; this.select();
  }

  // By keys: each Enter a corner, and once more in the same place the end; until then an end goes with the crosshair.
  corner(where, x, y) {
    const before = this.stroke.at(-2);
    if (before && before[0] === x && before[1] === y) { this.stroke.pop(); this.up(); return; }
    if (!this.stroke.length) this.down(where, x, y);
    this.stroke.push([x, y]); this.overlay();
  }

  lead(x, y) { if (this.stroke.length) { this.stroke[this.stroke.length - 1] = [x, y]; this.overlay(); } }

  cancel() { if (this.stroke.length) { this.stroke = []; this.overlay(); } }

  // What a stroke means: corners of a polygon, or places of the brush.
  corners(stroke) {
    const every = Math.ceil(stroke.length / MOST), points = stroke.filter((_, k) => k % every === 0 || k === stroke.length - 1).map((p) => p.map((v) => Math.round(v * 10) / 10));
    if (!this.along) return points;
    if (points[0][0] > points.at(-1)[0]) points.reverse();
    const line = []; // a hand that goes back draws no loop
    for (const p of points) if (!line.length || p[0] > line.at(-1)[0]) line.push(p);
    const far = this.mode === 'above' ? -1e6 : 1e6;
    return line.length < 2 ? [] : [...line, [line.at(-1)[0], far], [line[0][0], far]];
  }

  // The shape that is being drawn, as attributes of a path.
  shape() {
    if (!this.stroke.length || this.where !== 'cloud') return null;
    const d = `M${this.stroke.map((p) => p.map((v) => v.toFixed(1)).join(' ')).join('L')}`;
    return this.mode === 'brush' ? { d: this.stroke.length > 1 ? d : `${d}h0.1`, class: 'brush', 'stroke-width': 2 * this.radius } : { d: `${d}Z`, class: 'lasso' };
  }

  inSection(g) {
    if (!this.stroke.length || this.where !== 'section') return;
    g.beginPath(); this.stroke.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
    g.lineCap = g.lineJoin = 'round'; g.strokeStyle = this.mode === 'brush' ? '#e800b066' : '#e800b0'; g.lineWidth = this.mode === 'brush' ? 2 * this.radius : 2;
    if (this.mode === 'brush' && this.stroke.length === 1) g.lineTo(this.stroke[0][0] + 0.1, this.stroke[0][1]);
    if (this.mode === 'lasso') g.closePath();
    g.stroke();
  }

  // ---------------------------------------------------------------- the selection
  projection(where) {
    const o = this.scene.origin;
    if (where === 'section') {
      const { A, B, half, view: v } = this.section(), L = Math.hypot(B[0] - A[0], B[1] - A[1]), k = v.k / L;
      return {
        about: [A[0] + o[0], A[1] + o[1], v.low + o[2]], depth: null, slab: [A[0] + o[0], A[1] + o[1], B[0] + o[0], B[1] + o[1], half],
        matrix: [k * (B[0] - A[0]), k * (B[1] - A[1]), 0, v.left, 0, 0, -v.k * v.over, v.bottom, 0, 0, 0, 1],
      };
    }
    const [w, h] = this.size(), m = matrix(this.cam, w / h, this.cam.target), of = (f) => [0, 4, 8, 12].map(f);
    return {
      about: this.cam.target.map((v, i) => v + o[i]), depth: [this.cam.far / 100, this.cam.far * 12], slab: null,
      matrix: [...of((i) => ((m[i] + m[i + 3]) * w) / 2), ...of((i) => ((m[i + 3] - m[i + 1]) * h) / 2), ...of((i) => m[i + 3])],
    };
  }

  range(low, high, far, unit) {
    const ends = [low, high].map((id) => $(id).value.trim());
    return ends[0] === '' && ends[1] === '' ? null : [(ends[0] === '' ? -far : Number(ends[0])) / unit, (ends[1] === '' ? far : Number(ends[1])) / unit];
  }

  async select() {
    if (!this.last) return;
    const mine = (this.turn += 1);
    this.selection = null; this.steps(); this.count('counting …');
    const classes = Array.from({ length: 256 }, (_, code) => code).filter((code) => !this.hidden.has(code));
    try {
      const told = await json('0/select.json', { ...this.last, classes, confidence: this.range('least-sure', 'most-sure', 1e6, 100), height: this.range('lowest', 'highest', 1e6, 1) });
      if (mine !== this.turn) return;
      const { blocks } = told.echoes ? await marked(`0/marks-${told.selection}.bin`) : { blocks: [] };
      if (mine !== this.turn) return;
      this.scene.choose(blocks); this.selection = told.echoes ? told : null; this.count(this.words(told));
    } catch (e) { if (mine === this.turn) { this.drop(); this.count(e.message); this.told(e, true); } }
    this.steps();
  }

  words(told) {
    if (!told.echoes) return 'No echo is selected there: classes that are off and what the filters leave out never are.';
    const of = Object.entries(told.classes).sort((a, b) => b[1] - a[1]).map(([code, n]) => `${this.called(code)} ${n.toLocaleString('en')}`);
    return `${counted(told.echoes)} in ${counted(told.tiles, 'tile', 's')}: ${of.join(', ')}`;
  }

  called(code) { return Number(code) === 0 ? 'no class' : apart(this.scene.classes.find((c) => c.code === Number(code))?.name || `code ${code}`); }

  drop() { this.turn += 1; this.selection = null; this.last = null; this.scene.choose([]); this.count(''); this.steps(); }

  // ---------------------------------------------------------------- what is written
  async write(path, body, done) {
    if (this.busy) return;
    this.busy = true; this.steps();
    try { const told = await json(path, body); await this.follow(); done(told); } catch (e) { this.count(e.message); this.told(e, true); }
    this.busy = false; this.steps();
  }

  apply() {
    if (!this.may || this.busy) return;
    if (!this.selection) { this.count('Nothing is selected: draw first.'); return; }
    if ($('give').value === '?') { this.count(`${this.words(this.selection)}\nChoose the class to give, then apply.`); return; }
    const give = $('give').value, code = give === '' ? null : Number(give), words = code === null ? 'as delivered' : this.called(code);
    this.write('0/correct.json', { selection: this.selection.selection, code }, (told) => {
      this.drop();
      if (told.time) { this.done.push(told.time); this.undone.length = 0; }
      this.count(`Written: ${counted(told.echoes)} ${told.echoes === 1 ? 'is' : 'are'} ${words}${told.left ? `; ${told.left.toLocaleString('en')} ${told.left === 1 ? 'was' : 'were'} so already` : ''}.`);
    });
  }

  back(from, to, words) {
    if (!from.length) { this.count(from === this.done ? 'Nothing to undo.' : 'Nothing to do again.'); return; }
    this.write('0/revert.json', { time: from.at(-1) }, (told) => {
      from.pop(); if (told.time) to.push(told.time);
      this.count(`${words}: ${counted(told.echoes)}${told.left ? `; ${told.left.toLocaleString('en')} have another class by now and stay` : ''}.`);
    });
  }

  undo() { this.back(this.done, this.undone, 'Undone'); }
  redo() { this.back(this.undone, this.done, 'Done again'); }

  steps() {
    $('apply').disabled = !this.may || this.busy || !this.selection || $('give').value === '?'; $('undo').disabled = !this.may || this.busy || !this.done.length; $('redo').disabled = !this.may || this.busy || !this.undone.length;
    try { for (const name of ['done', 'undone']) sessionStorage.setItem(name, JSON.stringify(this[name])); } catch { /* undo ends with the page */ }
  }

  kept(name) { try { return JSON.parse(sessionStorage.getItem(name)).filter(Number.isSafeInteger); } catch { return []; } }

  // ---------------------------------------------------------------- what anyone wrote
  async follow() {
    const { head: [rows, anew], blocks } = await marked(`0/changes-${this.rows}.bin`, 8);
    if (this.lost) { this.lost = false; this.failed(''); }
    if (rows === this.rows && !anew) return;
    this.rows = rows;
    if (anew) this.scene.anew(); else this.scene.correct(blocks);
  }

  told(e, here) { if (e.status === 409) { this.gone = true; this.count(''); } if (!e.status || e.status === 410) this.lost = true; if (!here || [401, 409, 410].includes(e.status)) this.failed(e.message, e.status); }
}
