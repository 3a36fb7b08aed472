// What is known of a picked echo. Text of files is set as text, never as markup.
export const $ = (id) => document.getElementById(id);
export function element(kind, text = '', className = '') { const e = document.createElement(kind); if (text !== '') e.textContent = text; if (className) e.className = className; return e; }
export const counted = (n, one = 'echo', more = 'es') => `${n.toLocaleString('en')} ${one}${n === 1 ? '' : more}`;
export const number = (v) => (v === null || v === undefined ? '–' : typeof v !== 'number' ? String(v) : Number.isInteger(v) ? String(v) : Math.abs(v) >= 1000 ? v.toFixed(3) : Number(v.toPrecision(4)).toString());

// A name in a sentence: letters from right to left turn no number beside it, nor do marks that a file brought.
const TURNS = /[\u0590-\u08ff\u200e\u200f\u202a-\u202e\u2066-\u2069\ufb1d-\ufdff\ufe70-\ufeff]/;
export const apart = (name) => (TURNS.test(name) ? `\u2068${name}\u2069` : name);

export function row(table, ...cells) { const r = element('tr'); cells.forEach((c) => r.append(c instanceof Node ? c : element('td', c))); table.append(r); }

export function values(about, fields) {
  const table = $('values'); table.replaceChildren();
  const units = new Map(fields.map((f) => [f.name, f]));
  for (const [name, value] of Object.entries(about)) { const f = units.get(name) || {}; row(table, name, `${number(value)} ${f.unit || ''}`); table.lastChild.title = f.meaning || ''; }
}

// Shares of the classes, and the features that decide.
export function why(answer, colours) {
  const box = $('why'); box.replaceChildren();
  if (answer.error) { box.append(element('p', answer.error)); return; }
  const shares = element('table');
  for (const [name, share] of Object.entries(answer.shares)) {
    const bar = element('div', '', 'bar'), fill = element('div'), cell = element('td');
    fill.style.width = `${Math.round(100 * share)}%`; fill.style.background = colours.get(name) || '#17697a'; bar.append(fill); cell.append(bar);
    row(shares, name, cell, `${Math.round(100 * share)} %`);
  }
  box.append(element('h2', 'votes'), shares);
  if (!answer.features?.length) return;
  const t = element('table'); row(t, element('th', 'feature'), element('th', 'value'), element('th', '90 % of either class'), element('th', 'turns'));
  for (const f of answer.features.slice(0, 10)) row(t, breakable(f.name), number(f.value), span(f, answer, colours), `${Math.round(100 * f.effect)} %`);
  box.append(element('h2', 'why'), element('p', `The share of ${apart(answer.given)} that is lost where the feature has the median of ${apart(answer.other)}${answer.of}. Bars: where 90 % of ${apart(answer.given)} (above) and of ${apart(answer.other)} (below) lie${answer.of}; the line is this echo.`), t);
}

// A cell whose text may go on in the next line behind every `_`.
function breakable(name) {
  const cell = element('td');
  name.split('_').forEach((word, i) => { if (i) cell.append('_', element('wbr')); cell.append(word); });
  return cell;
}

// Two bars from the 5th to the 95th percentile of either class, and a line at the echo's own value.
function span(f, answer, colours) {
  const ends = [f.value, f.own_low, f.own_high, f.others_low, f.others_high].filter((v) => v !== null);
  const low = Math.min(...ends), wide = Math.max(...ends) - low || 1, at = (v) => `${(100 * (v - low)) / wide}%`;
  const cell = element('td'), bars = element('div', '', 'span');
  for (const [a, b, name] of [[f.own_low, f.own_high, answer.given], [f.others_low, f.others_high, answer.other]]) {
    const bar = element('div'); bar.hidden = a === null || b === null;
    if (!bar.hidden) { bar.style.left = at(a); bar.style.width = `max(2px, ${(100 * (b - a)) / wide}%)`; bar.style.background = colours.get(name) || '#17697a'; }
    bars.append(bar);
  }
  if (f.value !== null) { const line = element('i'); line.style.left = at(f.value); bars.append(line); }
  cell.title = `${apart(answer.given)}: ${number(f.own_low)} to ${number(f.own_high)}, median ${number(f.own)}; ${apart(answer.other)}: ${number(f.others_low)} to ${number(f.others_high)}, median ${number(f.others)}`;
  cell.append(bars);
  return cell;
}

// Samples, fit, echoes, the vendor's returns; below, the residual in units of noise.
export function wave(p, chosen) {
  const canvas = $('wave'), g = canvas.getContext('2d'), ratio = devicePixelRatio || 1;
  canvas.hidden = false; canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio; g.scale(ratio, ratio);
  const W = canvas.clientWidth, t = p.time, t0 = t[0], t1 = t.at(-1), high = Math.max(...p.samples, ...p.total.filter((v) => v !== null)), low = Math.min(...p.samples);
  const X = (v) => 30 + ((v - t0) / Math.max(t1 - t0, 1e-9)) * (W - 38), Y = (v) => 122 - ((v - low) / Math.max(high - low, 1)) * 108;
  const line = (xs, ys, colour, wide) => { g.beginPath(); g.strokeStyle = colour; g.lineWidth = wide; let on = false; xs.forEach((x, i) => { if (x === null || ys[i] === null) { on = false; return; } if (on) g.lineTo(X(x), Y(ys[i])); else g.moveTo(X(x), Y(ys[i])); on = true; }); g.stroke(); };
  g.font = '11px system-ui, sans-serif'; g.fillStyle = '#4a5a66';
  g.fillText(number(high), 2, 18); g.fillText(number(low), 2, 124); g.fillText('DN', 2, 32);
  for (const v of p.vendor) { g.fillStyle = '#9aa7b0'; g.fillRect(X(v) - 0.5, 8, 1, 116); }
  p.curves.forEach((c, i) => line(p.fine, c, i === chosen ? '#c2410c' : '#8aa0ab', i === chosen ? 2 : 1));
  line(p.fine, p.total, '#17697a', 1.4);
  g.fillStyle = '#1d2a35'; p.samples.forEach((v, i) => g.fillRect(X(t[i]) - 1.2, Y(v) - 1.2, 2.4, 2.4));
  g.strokeStyle = '#cfd8dd'; g.lineWidth = 1; for (const s of [-3, 0, 3]) { g.beginPath(); g.moveTo(30, 155 - s * 5); g.lineTo(W - 8, 155 - s * 5); g.stroke(); }
  g.fillStyle = '#4a5a66'; g.fillText('+3 σ', 2, 144); g.fillText('−3 σ', 2, 174);
  g.fillStyle = '#8b1a10'; p.residual.forEach((v, i) => { if (v !== null) g.fillRect(X(t[i]) - 0.7, 155, 1.4, -Math.max(-5, Math.min(5, v)) * 5); });
  g.fillStyle = '#4a5a66'; g.fillText(`${number(t0)} ns`, 30, 188); const end = `${number(t1)} ns`; g.fillText(end, W - 8 - g.measureText(end).width, 188);
}
