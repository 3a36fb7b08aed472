// Fetches blocks, inflates them and undoes their differences. What a block says of its size is held against limits
// before memory is taken.
const HEAD = 64, MOST = 8_000_000, STRIDE = 12, STEP = 0.01;

async function inflated(packed, size) {
  const out = new Uint8Array(size), reader = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate')).getReader();
  let at = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    if (at + value.length > size) { reader.cancel().catch(() => {}); throw new Error('a block is longer than it says'); }
    out.set(value, at); at += value.length;
  }
  if (at !== size) throw new Error('a block is shorter than it says');
  return out;
}

function head(view, at) {
  const u = (k) => view.getUint32(at + 4 * k, true), d = (k) => view.getFloat64(at + 24 + 8 * k, true);
  return { size: u(0), node: [u(1), u(2), u(3)], count: u(4), low: [d(0), d(1), d(2)], step: d(3), rise: d(4) };
}

// Twelve bytes an echo: x, y, z, height (16 bits each), intensity, class, confidence.
function unpacked(planes, n, rise) {
  const out = new Uint8Array(STRIDE * n), words = new Uint16Array(out.buffer);
  let x = 0, y = 0, z = 0, h = 0;
  const difference = (axis, k) => { const v = planes[2 * axis * n + k] | (planes[(2 * axis + 1) * n + k] << 8); return (v >>> 1) ^ -(v & 1); };
  for (let k = 0; k < n; k += 1) {
    x = (x + difference(0, k)) & 65535; y = (y + difference(1, k)) & 65535; z = (z + difference(2, k)) & 65535; h += difference(3, k);
    const w = 6 * k, b = 12 * k;
    words[w] = x; words[w + 1] = y; words[w + 2] = z; words[w + 3] = (h + Math.trunc((z * rise) / STEP)) & 65535;
    out[b + 8] = planes[8 * n + k]; out[b + 9] = planes[9 * n + k]; out[b + 10] = planes[10 * n + k]; out[b + 11] = planes[11 * n + k];
  }
  return out;
}

onmessage = async ({ data: { id, path, headers, column, stride } }) => {
  let bytes = 0, status = 0;
  try {
    const answer = await fetch(path, { headers });
    status = answer.status;
    if (!answer.ok) {
      let words = '';
      try { words = JSON.parse(await answer.text()).error; } catch { /* no words */ }
      throw new Error(words || `status ${status}`);
    }
    const all = new Uint8Array(await answer.arrayBuffer()), view = new DataView(all.buffer);
    bytes = all.length;
    for (let at = 0; at < all.length;) {
      if (at + HEAD > all.length) throw new Error('a block is cut off');
      const block = head(view, at);
      if (block.count > MOST || at + HEAD + block.size > all.length) throw new Error('a block says that it is larger than it can be');
      const planes = await inflated(all.subarray(at + HEAD, at + HEAD + block.size), block.count * (stride || (column ? 1 : STRIDE)));
      block.bytes = column || stride ? planes : unpacked(planes, block.count, block.rise);
      postMessage({ id, blocks: [block] }, [block.bytes.buffer]);
      at += HEAD + block.size;
    }
    postMessage({ id, end: true, bytes });
  } catch (fault) { postMessage({ id, end: true, bytes, status, fault: String(fault.message || fault) }); }
};
