import { fit, matrix, onHeight, project, axes, start, FIELD } from './camera.js';
import { BUDGET, Scene } from './scene.js';
import { Drawing, MODES, pixel } from './draw.js';
import { joined, legend } from './legend.js';
import { pick, touches } from './pick.js';
import { $, apart, counted, element, values, wave, why } from './panel.js';
import { json, traffic, useDelivery, useToken } from './net.js';
import { kept, little } from './folder.js';
import { Again } from './again.js';
import { Relabel } from './relabel.js';
import { ARROWS, Crosshair } from './crosshair.js';
import { held, Section } from './section.js';

const given = new URLSearchParams(location.hash.slice(1)), cam = { ...start }, hidden = new Set();
const stats = { first: 0, settled: 0, drawn: 0, frames: [], pick: 0, begun: performance.now() };
const state = { by: 'classification', look: { mode: 0, low: 0, high: 1, metres: 0.35 }, tool: '', points: [], moving: 0, dirty: true, sketched: false, section: null, selected: null, motion: 600_000, shade: true };
let scenes = [], drawing, works = null, total = 0, at = -1, shown = [], relabel = null, again = null, cross, section;
useToken(given.get('token') || ''); $('unserved').remove();
const inSight = (id) => $(id).scrollIntoView({ block: 'nearest' }); // on a phone the panel is longer than its place
const says = (text) => { $('says').textContent = text; if (text) inSight('says'); };
const fault = (text) => { if ($('fault').textContent === (text || '')) return; $('fault').hidden = !text; $('fault').textContent = text || ''; if (text) inSight('fault'); };
const failed = (text, status) => { $('take').hidden = status !== 409; fault(status === 401 ? 'The address lacks the token, or fwclass view was started again: open the address that it printed last.' : text); };
async function take() { try { await json('0/reopen.json', {}); location.reload(); } catch (e) { failed(e.message, e.status); } }
$('take').onclick = take;
const canvas = $('view');

// ------------------------------------------------------------------ frames
const size = () => [canvas.clientWidth / scenes.length, canvas.clientHeight];
function frame() {
  requestAnimationFrame(frame);
  if (!(state.dirty || state.sketched) || document.hidden) return;
  const began = performance.now(), [w, h] = size(), m = matrix(cam, w / h), moving = began - state.moving < 250;
  if (!w || !h) return;
  state.sketched = false;
  if (!state.dirty) { marks(m, w, h); if (state.section?.picture) section.sketch(); return; }
  state.dirty = moving;
  const line = state.section, full = line && ((low, high) => touches(low, high, line.A, line.B, line.half));
  shown = scenes.map((s) => {
    const nodes = s.select(cam, m, w, h, BUDGET / scenes.length, full);
    if (!moving) return { nodes };
    let sum = 0;
    return { nodes: nodes.filter((n) => (sum += n.count) <= state.motion / scenes.length || n.level === nodes[0].level) };
  });
  stats.drawn = drawing.draw(cam, shown, state.look, state.shade || !moving); // a slow machine shades what stands still
  if (moving) { // the pixels are read, so that what was asked for is done
    drawing.gl.readPixels(0, 0, 1, 1, drawing.gl.RGBA, drawing.gl.UNSIGNED_BYTE, new Uint8Array(4));
    const took = performance.now() - began; stats.frames.push(took); if (stats.frames.length > 500) stats.frames.shift();
    state.shade = took < (state.shade ? 80 : 25);
    state.motion = Math.max(100_000, Math.min(BUDGET, state.motion * (took > 80 ? Math.max(0.4, 65 / took) : took < 50 ? 1.1 : 1)));
  }
  const now = performance.now() - stats.begun, busy = scenes.some((s) => s.loader.busy);
  if (stats.drawn && !stats.first) stats.first = now;
  stats.settled = busy || moving ? 0 : stats.settled || now;
  $('facts').textContent = `${stats.drawn.toLocaleString('en')} of ${scenes.reduce((n, s) => n + s.echoes, 0).toLocaleString('en')} echoes${busy ? ', more are coming' : ''}`;
  marks(m, w, h);
  if (line && !busy && line.stale) section.measure(); else if (line?.picture) section.sketch();
}
const redraw = () => { state.dirty = true; stats.settled = 0; if (state.section) state.section.stale = true; };
const overlay = () => { state.sketched = true; }; // only what lies over the echoes has changed
function moved() { state.moving = performance.now(); state.dirty = true; stats.settled = 0; clearTimeout(moved.timer); moved.timer = setTimeout(() => { state.dirty = true; remember(); }, 300); }

// ------------------------------------------------------------------ the address
function remember() {
  const o = scenes[0].origin, p = new URLSearchParams();
  if (given.get('token')) p.set('token', given.get('token'));
  p.set('at', [cam.target[0] + o[0], cam.target[1] + o[1], cam.target[2] + o[2], cam.far].map((v) => v.toFixed(2)).concat(cam.azimuth.toFixed(4), cam.tilt.toFixed(4)).join(','));
  p.set('by', state.by);
  if (hidden.size) p.set('without', [...hidden].join(','));
  if (relabel?.open) p.set('relabel', '1');
  history.replaceState(null, '', `#${p.toString().replaceAll('%2C', ',')}`);
}
function whole() { // heights by their mean, as one stray echo would draw the middle away
  const { bounds: b, height, origin: o, tiles } = scenes[0], [w, h] = size(), reach = Math.max(b[2] - b[0], b[3] - b[1]) / 8;
  const middle = (k) => tiles.map((t) => t[k]).sort((p, q) => p - q)[tiles.length >> 1], ends = [Math.max(middle(3), height - reach), Math.min(middle(4), height + reach)];
  cam.azimuth = start.azimuth; cam.tilt = start.tilt;
  fit(cam, [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [b[2 * (k & 1)] - o[0], b[2 * ((k >> 1) & 1) + 1] - o[1], ends[k >> 2] - o[2]]), w / h, height - o[2]); moved();
}
function recall() {
  const o = scenes[0].origin, v = (given.get('at') || '').split(',').map(Number);
  if (v.length === 6 && v.every(Number.isFinite) && v[3] > 0) { cam.target = [v[0] - o[0], v[1] - o[1], v[2] - o[2]]; cam.far = v[3]; [cam.azimuth, cam.tilt] = v.slice(4); moved(); } else whole();
  for (const code of (given.get('without') || '').split(',').filter(Boolean).map(Number)) hidden.add(code);
}

// ------------------------------------------------------------------ colours
const STORED = { height: 'z' }; // what the run calls a colour
async function colourBy(name) {
  if (MODES[name] === undefined && !scenes[0].columns.some((c) => c.name === name)) name = 'classification';
  const mode = MODES[name] ?? 5, having = scenes.filter((s) => name === 'height' || s.columns.some((c) => c.name === name));
  const before = state.by; let about = {};
  state.by = name; $('by').value = name;
  try {
    if (mode) about = joined(await Promise.all(having.map((s) => json(`${s.number}/${STORED[name] || name}/scale.json`))));
  } catch (e) { failed(e.message, e.status); if (state.by === name) { state.by = before; $('by').value = before; } return; } // the cloud keeps its colours
  if (state.by !== name) return;
  const o = name === 'height' ? scenes[0].origin[2] : 0;
  if (about.classes) { state.look.mode = 6; categories(about.classes); } else Object.assign(state.look, { mode, ...(mode === 5 ? { low: 0, high: 1 } : { low: about.low - o, high: about.high - o }) });
  for (const s of scenes) s.by(mode === 5 && having.includes(s) ? name : '');
  legend(name, about); for (const s of scenes) if (mode && !having.includes(s)) $('legend').append(element('p', `${s.run} has no such column.`)); redraw(); remember();
}
function categories(list) { drawing.palette.fill(255, 4 * 256); for (const c of list) drawing.palette.set([...rgb(c.colour), 255], 4 * (256 + c.code)); drawing.setPalette(); }
const rgb = (css) => [1, 3, 5].map((k) => parseInt(css.slice(k, k + 2), 16));
function classes() {
  const known = new Map(); for (const c of scenes.flatMap((s) => s.classes)) { const same = known.get(c.code); known.set(c.code, same && same.name !== c.name ? { ...same, name: `${apart(same.name)} | ${apart(c.name)}` } : same || c); }
  for (let code = 0; code < 256; code += 1) drawing.palette.set([...rgb(known.get(code)?.colour || '#9aa0a6'), hidden.has(code) ? 0 : 255], 4 * code);
  drawing.setPalette();
  const box = $('classes'); box.replaceChildren();
  for (const c of known.values()) {
    const l = element('label'), tick = element('input'), dot = element('i'); tick.type = 'checkbox'; tick.checked = !hidden.has(c.code); dot.style.background = c.colour;
    tick.onchange = () => { if (tick.checked) hidden.delete(c.code); else hidden.add(c.code); drawing.palette[4 * c.code + 3] = tick.checked ? 255 : 0; drawing.setPalette(); redraw(); remember(); relabel?.select(); };
    l.append(tick, dot, element('span', c.name || `code ${c.code}`), element('small', c.code)); box.append(l);
  }
}

// ------------------------------------------------------------------ tools
function tool(name) {
  state.tool = state.tool === name ? '' : name; state.points = [];
  for (const id of ['section', 'measure']) $(id).setAttribute('aria-pressed', String(state.tool === id));
  says(state.tool === 'section' && !relabel?.along ? 'Click both ends of the section.' : state.tool === 'measure' ? 'Click two echoes.' : '');
  relabel?.hint(); redraw();
}
const svg = (kind, attributes, text) => { const e = document.createElementNS('http://www.w3.org/2000/svg', kind); for (const [k, v] of Object.entries(attributes)) e.setAttribute(k, v); if (text) e.textContent = text; return e; };
function marks(m, w, h) {
  const out = [], left = [], at2 = (p) => project(m, p, w, h);
  const line = (a, b) => { const A = at2(a), B = at2(b); if (A[2] > 0 && B[2] > 0) for (const name of ['under', 'over']) out.push(svg('line', { class: name, x1: A[0], y1: A[1], x2: B[0], y2: B[1] })); return [A, B]; };
  const circle = (p, r) => { const [x, y, d] = at2(p); if (d > 0) out.push(svg('circle', { cx: x, cy: y, r })); };
  if (state.section) line(state.section.A, state.section.B);
  for (const p of state.points) circle(p, 5);
  if (state.measured) { const [a, b] = state.measured, [A, B] = line(a, b); if (A[2] > 0 && B[2] > 0) out.push(svg('text', { x: (A[0] + B[0]) / 2 + 6, y: (A[1] + B[1]) / 2 - 6 }, `${Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]).toFixed(2)} m`)); }
  if (works?.[at]) { // the squares of the unsure place
    const [x0, y0, x1, y1] = works[at].box, o = scenes[0].origin, corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(([x, y]) => at2([x - o[0], y - o[1], works[at].z - o[2]]));
    if (corners.every((c) => c[2] > 0)) out.push(svg('path', { class: 'frame', d: `M${corners.map((c) => `${c[0]} ${c[1]}`).join('L')}Z` }));
  }
  for (const t of marked()) { t.at = at2(t.place); if (t.at[2] > 0) left.push(svg('circle', { cx: t.at[0], cy: t.at[1], r: 4 })); }
  if (state.selected) circle(state.selected.place, 8);
  const shape = relabel?.shape(); if (shape) out.push(svg('path', shape));
  $('marks').replaceChildren(...scenes.map((_, k) => { const half = svg('svg', { x: k * w, y: 0, width: w, height: h }); half.append(...(k ? out.map((e) => e.cloneNode(true)) : [...out, ...left])); return half; }));
}
function chosen(hit, x, y) {
  const [w, h] = size();
  if (state.tool === 'section') {
    const p = hit?.place || onHeight(cam, x % w, y, w, h);
    if (!p) { says('There is nothing but sky: click an echo, or the ground.'); return; }
    const [first] = state.points;
    if (first && Math.hypot(p[0] - first[0], p[1] - first[1]) < 0.1) { says('That is where the section begins: click its other end, elsewhere.'); return; }
    state.points.push(p); says('Click the other end.');
    if (state.points.length === 2) { cutAlong({ A: state.points[0], B: state.points[1], half: held('width') / 2, stale: true }); tool(''); }
  } else if (!hit) says('No echo is there: click two echoes.'); else {
    state.points.push(hit.place); says('Click the other echo.');
    if (state.points.length === 2) {
      const [a, b] = state.points, flat = Math.hypot(b[0] - a[0], b[1] - a[1]);
      state.measured = [a, b]; tool(''); says(`${Math.hypot(flat, b[2] - a[2]).toFixed(2)} m; sideways ${flat.toFixed(2)} m, upwards ${(b[2] - a[2]).toFixed(2)} m`);
    }
  }
  redraw();
}
// The cloud is drawn in what its section leaves, so that the line stays in sight.
function cutAlong(line) { state.section = line; $('profile').hidden = !line; $('stage').classList.toggle('cut', Boolean(line)); if (!line && relabel?.along) relabel.use(''); cross.show(); redraw(); }
// ------------------------------------------------------------------ one echo
// One request of a kind at a time: what a hand that clicks on does not wait for any more is not asked for.
const asked = {};
async function alone(kind, path, late) {
  await asked[kind]?.catch(() => null);
  return late() ? null : (asked[kind] = json(path));
}
const named = (s, { classification: code, confidence: sure }) => `${apart(s.classes.find((c) => c.code === code)?.name ?? `code ${code}`)}, ${sure == null ? 'confidence unknown' : `${Math.round(100 * sure)} % sure`}`;
async function show(number_, hit) {
  state.selected = hit; overlay();
  const s = scenes[number_], mine = (show.turn = (show.turn || 0) + 1), began = performance.now(), late = () => mine !== show.turn || state.selected !== hit;
  try {
    const about = s.folder ? await kept(s, hit) : await alone('echo', `${number_}/echo/${hit.node.node.join('-')}/${hit.row}.json`, late), v = about?.values; if (late()) return;
    stats.echo = about;
    const corrected = about.corrected == null ? '' : `; corrected: ${relabel ? relabel.called(about.corrected) : `code ${about.corrected}`}`, twin = scenes[1 - number_];
    const by = about.reference == null ? '' : `; reference: ${apart(s.classes.find((c) => c.code === about.reference)?.name ?? `code ${about.reference}`)}`;
    const beside = about.other === undefined ? '' : `; in ${twin.run} ${about.other ? named(twin, about.other) : 'there is no such echo'}`;
    $('picked').hidden = false; $('what').textContent = `${named(s, v)}${by}${corrected}${beside}`;
    says(`${scenes.length > 1 ? `${s.run}: ` : ''}${v.x.toFixed(2)}, ${v.y.toFixed(2)}, ${v.z.toFixed(2)} m; strip ${v.strip}, pulse ${v.pulse}, echo ${v.echo_number}${v.number_of_echoes ? ` of ${v.number_of_echoes}` : ''}`);
    values(v, s.columns); $('why').replaceChildren(); $('wave').hidden = true; $('wave-says').textContent = about.little ? little(s) : ''; reveal();
    if (about.little) return;
    if (!s.waveforms.strips.includes(v.strip)) $('wave-says').textContent = s.waveforms.says;
    else await alone('pulse', `${number_}/pulse/${v.strip}-${v.pulse}.json`, late).then((p) => { if (late()) return; stats.wave = p; stats.wave_ms = performance.now() - began; wave(p, v.echo_number - 1); $('wave-says').textContent = p.says; }, (e) => { if (!late()) $('wave-says').textContent = e.message; });
    alone('why', `${number_}/why/${v.strip}-${v.pulse}-${v.echo_number}.json`, late).then((a) => { if (late()) return; stats.why = a; stats.why_ms = performance.now() - began; why(a, new Map(s.classes.map((c) => [c.name, c.colour]))); reveal(); }, (e) => { if (!late()) why({ error: e.message }, new Map()); });
  } catch (e) { if (!late()) failed(e.message, e.status); }
}
// What is told of an echo stands below the classes and the tools: the panel goes there where it would be out of sight.
function reveal() {
  const panel = $('panel').getBoundingClientRect();
  if ($('what').getBoundingClientRect().bottom > panel.bottom - 80) $('panel').scrollTop += $('says').getBoundingClientRect().top - panel.top - $('work').offsetHeight - 8;
}
function click(x, y) {
  const began = performance.now(), [w, h] = size(), k = Math.min(scenes.length - 1, Math.floor(x / w));
  const told = state.tool ? null : marked().find((t) => Math.hypot(t.at[0] - x, t.at[1] - y) < 9);
  if (told) { show(0, { ...told, node: { node: told.node } }); return told; }
  const hit = pick(shown[k]?.nodes || [], matrix(cam, w / h), x - k * w, y, w, h, hidden); stats.pick = performance.now() - began;
  if (state.tool) chosen(hit, x, y); else if (hit) show(k, hit);
  return hit;
}

// ------------------------------------------------------------------ work list
async function go(step) {
  if (!works) ({ places: works, total } = await json('0/work.json'));
  if (!works.length) { $('place').textContent = 'no unsure place'; return; }
  at = at < 0 && step < 0 ? works.length - 1 : (at + step + works.length) % works.length;
  const p = works[at], o = scenes[0].origin;
  const [x0, y0, x1, y1] = p.box, [w, h] = size(), across = 0.6 * Math.hypot(x1 - x0, y1 - y0); // its frame is in sight, on half a phone too
  cam.target = [(x0 + x1) / 2 - o[0], (y0 + y1) / 2 - o[1], p.z - o[2]]; cam.far = Math.max(25, p.size * 4, across / Math.tan(FIELD / 2) / Math.min(1, w / h));
  const called = new Map(scenes[0].classes.map((c) => [c.code, c.name])), classes_ = p.classes.slice(0, 3).map(([code, n]) => `${apart(called.get(code) || `code ${code}`)} ${n.toLocaleString('en')}`).join(', ');
  $('place').textContent = `${scenes.length > 1 ? `${scenes[0].run}: ` : ''}${at + 1} of ${works.length}${total > works.length ? `, the largest of ${total.toLocaleString('en')} places` : ''}: ${counted(p.echoes)}, ${Math.round(100 * p.confidence)} % sure: ${classes_}`; moved();
  const [told] = marked(); if (told) show(0, { ...told, node: { node: told.node } });
}
const marked = () => works?.[at]?.told || []; // echoes of which a folder has everything
const step = (by) => go(by).catch((e) => failed(e.message, e.status));

// ------------------------------------------------------------------ hands
const fingers = new Map(); let travelled = 0;
function shift(dx, dy) { const { right, up } = axes(cam), k = (cam.far * 2 * Math.tan(FIELD / 2)) / size()[1]; cam.target = cam.target.map((t, i) => t - right[i] * dx * k + up[i] * dy * k); moved(); }
function turn(dx, dy) { cam.azimuth -= dx * 0.006; cam.tilt = Math.min(1.5707, Math.max(0.02, cam.tilt + dy * 0.006)); moved(); }
function nearer(by) { cam.far = Math.min(1e6, Math.max(1, cam.far * by)); moved(); }
canvas.onpointerdown = (e) => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); if (fingers.size === 1) travelled = 0;
  if (fingers.size === 1 && e.button === 0 && !e.shiftKey && !state.tool && relabel?.draws('cloud')) relabel.down('cloud', e.offsetX, e.offsetY); else relabel?.cancel(); };
canvas.onpointermove = (e) => {
  const was = fingers.get(e.pointerId); if (!was) return;
  const dx = e.clientX - was[0], dy = e.clientY - was[1], other = [...fingers].find(([id]) => id !== e.pointerId)?.[1];
  travelled += Math.abs(dx) + Math.abs(dy); fingers.set(e.pointerId, [e.clientX, e.clientY]);
  if (relabel?.stroke.length) { relabel.move(e.offsetX, e.offsetY); return; }
  if (travelled < 4) return;
  if (other) { const far = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1; nearer(far(was) / far([e.clientX, e.clientY])); shift(dx / 2, dy / 2); } else if (e.shiftKey || e.buttons & 6) shift(dx, dy); else turn(dx, dy);
};
canvas.onpointerup = (e) => { const only = fingers.size === 1; fingers.delete(e.pointerId); if (relabel?.stroke.length) { if (travelled < 4 && relabel.mode !== 'brush') relabel.cancel(); else { relabel.up(); return; } } const r = canvas.getBoundingClientRect(); if (only && travelled < 4 && e.button === 0) click(e.clientX - r.left, e.clientY - r.top); };
canvas.onpointercancel = (e) => { fingers.delete(e.pointerId); relabel?.cancel(); };
canvas.oncontextmenu = (e) => e.preventDefault();
canvas.addEventListener('wheel', (e) => { e.preventDefault(); nearer(Math.exp(Math.max(-200, Math.min(200, e.deltaY)) * 0.0015)); }, { passive: false });
const fromAbove = () => { cam.tilt = 1.5707; cam.azimuth = 0; moved(); };
const sized = (by) => { $('brush-size').value = Number($('brush-size').value) + by; overlay(); };
const relabelling = { l: () => relabel.use('lasso'), b: () => relabel.use('brush'), a: () => relabel.use('above'), u: () => relabel.use('below'), Enter: () => relabel.apply(), z: () => relabel.undo(), y: () => relabel.redo(), '[': () => sized(-4), ']': () => sized(4) };
const keys = { r: () => edit(), '+': () => nearer(0.8), '-': () => nearer(1.25), q: () => turn(-30, 0), e: () => turn(30, 0), 0: whole, t: fromAbove, s: () => tool('section'), m: () => tool('measure'), c: crosshair, '?': () => { $('help').open = !$('help').open; if ($('help').open) inSight('help'); }, n: () => step(1), p: () => step(-1), Escape: () => { if (relabel?.stroke.length) relabel.cancel(); else if (relabel?.last) { relabel.drop(); relabel.hint(); } else if (state.tool || relabel?.mode) { if (relabel?.along || !state.tool) relabel.use(''); if (state.tool) tool(''); } else if (cross.over) { cross.away(); says(''); relabel?.hint(); } else { state.measured = state.selected = null; says(''); cutAlong(null); } } };
section = new Section({ state, scenes: () => scenes, relabel: () => relabel, hidden, colour: (e) => pixel(state.look, drawing.palette, e.node, e.row, e.z), redraw, show, close: () => cutAlong(null) });
cross = new Crosshair({
  canvases: [canvas, $('cut')], halves: () => scenes.length, led: (x, y) => relabel?.lead(x, y),
  press: (over, x, y) => { const where = over === canvas ? 'cloud' : 'section'; if (relabel?.draws(where) && !state.tool) relabel.corner(where, x, y); else if (over === canvas) click(x, y); else section.click(x, y); },
});
function crosshair() { cross.next(); canvas.focus(); says(!cross.over ? '' : `Arrows move the crosshair, with shift by one pixel; Enter is a click. c takes it ${cross.over === canvas && state.section ? 'to the section' : 'away'}.`); relabel?.cancel(); relabel?.hint(); }
function pressed(e) {
  const { tagName, type } = e.target;
  if (e.ctrlKey || e.metaKey || e.altKey || (e.key === 'Enter' && /BUTTON|SUMMARY/.test(tagName))) return;
  if (tagName === 'SELECT' || (tagName === 'INPUT' && type !== 'checkbox')) { if (e.key === 'Escape') canvas.focus(); return; }
  const arrow = ARROWS[e.key], act = arrow ? () => (cross.over ? cross.move(arrow, e.shiftKey) : shift(-40 * arrow[0], -40 * arrow[1])) : e.key === 'Enter' && cross.over && !relabel?.last ? () => cross.enter() : keys[e.key] || (relabel?.open && relabelling[e.key]);
  if (act) { e.preventDefault(); act(); }
}
addEventListener('keydown', pressed);
$('whole').onclick = whole; $('top').onclick = fromAbove; $('section').onclick = () => tool('section'); $('measure').onclick = () => tool('measure');
$('next').onclick = () => step(1); $('previous').onclick = () => step(-1); $('by').onchange = () => colourBy($('by').value);
addEventListener('resize', () => { cross.show(); moved(); redraw(); });
canvas.addEventListener('webglcontextlost', (e) => { e.preventDefault(); fault('The graphics card dropped this page; it is asked again.'); });
canvas.addEventListener('webglcontextrestored', () => { drawing.start(); fault(''); redraw(); });

// ------------------------------------------------------------------ corrections
function noClass(s) { if (!s.classes.some((c) => c.code === 0)) { s.classes.push({ code: 0, name: 'no class', colour: '#9aa0a6' }); classes(); } }
async function edit() { if (!relabel) { says(scenes[0]?.folder ? 'A folder only shows: fwclass view relabels.' : 'Two runs side by side are not relabelled: open one of them alone.'); return; } noClass(scenes[0]); const opened = relabel.toggle(); remember(); if (relabel.open) again.look(); await opened; }
function relabels(first) {
  if (!first.relabels) return;
  useDelivery(first.delivery);
  if (first.rows) noClass(first);
  const wantSection = () => { if (state.tool !== 'section') tool('section'); }, leaveTool = () => { if (state.tool) tool(''); };
  relabel = new Relabel({ scene: first, cam, size, hidden, section: () => state.section, wantSection, leaveTool, using: () => state.tool, keyed: () => cross.over, redraw, overlay, failed, pressed: () => canvas.classList.toggle('drawing', Boolean(relabel?.mode && !relabel.along)) });
  again = new Again({ take, open: () => relabel.open, drawing: () => relabel.last || relabel.stroke.length });
  $('relabel').hidden = false; $('relabel').onclick = edit;
  if (given.get('relabel')) edit();
}

// ------------------------------------------------------------------ begin
async function begin() {
  drawing = new Drawing(canvas);
  const first = await Scene.open(0, redraw, failed);
  scenes = [first];
  if (first.against) {
    scenes.push(await Scene.open(1, redraw, failed));
    scenes[1].moveTo(first.origin);
  }
  for (const s of scenes) Object.assign(s, { name: apart(s.name), run: apart(s.run) });
  const names = scenes.map((s) => (scenes.length > 1 ? `${s.name}: ${s.run}` : s.name)); $('name').textContent = names.join(' | ');
  if (scenes.length > 1) $('halves').replaceChildren(...names.map((n) => { const half = element('span'); half.append(element('b', n)); return half; })); document.title = `${names.join(' | ')} – fwclass view`;
  const by = new Set(['classification', 'confidence', 'entropy', 'height', 'height_above_ground', 'intensity', ...first.columns.map((c) => c.name)]);
  for (const n of by) if (n === 'height' || ((MODES[n] !== undefined || !first.folder || first.folder.columns.includes(n)) && first.columns.some((c) => c.name === n))) $('by').add(new Option(n.replaceAll('_', ' '), n));
  if (!first.crs) $('says').textContent = 'The survey names no coordinate system: places are in its own metres.';
  $('work').hidden = false; if (first.goes_through) $('place').textContent = first.goes_through; recall(); relabels(first); classes(); await colourBy(given.get('by') || 'classification'); frame();
}
window.fwclass = { cam, stats, traffic, state, click, show, moved, redraw, colourBy, tool, scenes: () => scenes, relabel: () => relabel, again: () => again, edit, shown: () => shown, step, cross: () => cross, keys: () => [...Object.keys(keys), ...Object.keys(relabelling)] };
begin().catch((e) => failed(e.message, e.status));
