// What a colour stands for.
import { rampColours } from './draw.js';
import { $, element, number } from './panel.js';

// Two runs have one scale of colours.
export function joined(scales) {
  const end = (choose, name) => { const ends = scales.map((s) => s[name]).filter((v) => typeof v === 'number'); return ends.length ? choose(...ends) : null; };
  return { ...scales[0], low: end(Math.min, 'low'), high: end(Math.max, 'high'), least: end(Math.min, 'least'), most: end(Math.max, 'most') };
}

export function legend(name, about) {
  const box = $('legend'), { low, high, least, most } = about; box.replaceChildren();
  if (name === 'classification') return;
  if (about.classes) { for (const c of about.classes) { const l = element('div', '', 'row'), i = element('i'); i.style.background = c.colour; l.append(i, element('span', c.name)); box.append(l); } return; }
  const c = document.createElement('canvas'), g = c.getContext('2d'); c.width = 256; c.height = 1;
  const ramp = g.createLinearGradient(0, 0, 256, 0); for (let k = 0; k < rampColours.length / 3; k += 1) ramp.addColorStop(k / (rampColours.length / 3 - 1), `rgb(${rampColours.slice(3 * k, 3 * k + 3).join(',')})`);
  g.fillStyle = ramp; g.fillRect(0, 0, 256, 1);
  const ends = element('div', '', 'ends'), place = Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(high - low)))), rounded = (v) => Number(v.toFixed(place)).toString();
  if (low === null) ends.append(element('span', 'no echo has a value'));
  else if (low === high) ends.append(element('span', `${number(low)} ${about.unit}`));
  else ends.append(element('span', `${least < low ? '≤ ' : ''}${rounded(low)}`), element('span', about.unit), element('span', `${most > high ? '≥ ' : ''}${rounded(high)}`));
  box.append(c, ends); if (about.meaning) box.append(element('p', about.meaning));
  if (least < low || most > high) ends.title = 'From 1 to 99 % of the values have colours of their own: one that strays flattens none.';
}
