// What a page that was exported to a folder knows of an echo.
import { json } from './net.js';

// What is said of an echo that the folder knows little of.
export const little = (scene) => `The folder has ${scene.waveforms.strips.length ? 'waveform, ' : ''}votes and columns of the echoes that are circled at the unsure places. Of every echo fwclass view has them.${scene.rows ? ' Classes are as corrected up to the export.' : ''}`;
const STRIDE = 7; // bytes of an identity

// As the server answers; of most echoes only who they are and what their block has.
export async function kept(scene, { node, row, place, echo }) {
  const name = echo || await identity(scene, node, row);
  if (scene.told.has(name)) return json(`${scene.number}/echo/${node.node.join('-')}/${row}.json`);
  const [x, y, z] = place.map((v, a) => v + scene.origin[a]), [strip, pulse, echo_number] = name.split('-').map(Number), b = node.bytes.subarray(12 * row, 12 * row + 12);
  const height = b[6] + 256 * b[7];
  return { little: true, values: { x, y, z, strip, pulse, echo_number, classification: b[10], confidence: b[11] === 255 ? null : b[11] / 200, height_above_ground: height ? (height - 1) / 100 - 100 : null, intensity: b[8] + 256 * b[9] } };
}

async function identity(scene, node, row) {
  const { bytes: p, count: n } = await scene.block(`identity/${node.node.join('-')}`, STRIDE);
  if (n !== node.count) throw new Error('the blocks of the folder do not fit each other: it is of two exports');
  const of = (first, bytes) => { let v = 0; for (let k = first + bytes - 1; k >= first; k -= 1) v = v * 256 + p[k * n + row]; return v; };
  return `${of(0, 2)}-${of(2, 4)}-${of(6, 1)}`;
}
