// Requests of the scene's data; token and delivery go as headers.
const headers = {};
export const traffic = { requests: 0, bytes: 0 };
export const useToken = (text) => { if (text) headers['X-Fwclass-Token'] = text; };
export const useDelivery = (name) => { headers['X-Fwclass-Delivery'] = name; };

async function asked(path, body) {
  const way = body === undefined ? { headers } : { method: 'POST', headers: { ...headers, 'Content-Type': 'application/json' }, body: JSON.stringify(body) };
  let answer, bytes;
  try { answer = await fetch(`data/${path}`, way); bytes = await answer.arrayBuffer(); } catch {
    throw new Error('The server does not answer: it was ended, or this machine slept. If it was fwclass view, start that again and open the address that it prints.');
  }
  traffic.requests += 1; traffic.bytes += bytes.byteLength;
  if (!answer.ok) throw Object.assign(new Error(parsed(bytes)?.error || `not here (${answer.status})`), { status: answer.status });
  return bytes;
}

const parsed = (bytes) => { try { return JSON.parse(new TextDecoder().decode(bytes)); } catch { return null; } };

// A folder has files that say why something is not there.
export async function json(path, body) {
  const value = parsed(await asked(path, body)) || { error: `not here (${path} is no JSON)` };
  if (value.error) throw Object.assign(new Error(value.error), { status: 200 });
  return value;
}

// Rows of blocks, with a byte each: from byte `at` on of an answer.
export async function marked(path, at = 0) {
  const data = await asked(path), view = new DataView(data), head = Array.from({ length: at / 4 }, (_, k) => view.getUint32(4 * k, true)), blocks = [];
  while (at < data.byteLength) {
    const u = (k) => view.getUint32(at + 4 * k, true), n = u(3);
    if (at + 16 + 5 * n > data.byteLength) throw new Error('marks are cut off');
    blocks.push({ key: `${u(0)}-${u(1)}-${u(2)}`, rows: new Uint32Array(data, at + 16, n), values: new Uint8Array(data, at + 16 + 4 * n, n) });
    at += 16 + 4 * n + ((n + 3) & ~3);
  }
  return { head, blocks };
}

// Blocks are fetched and inflated by workers, the most wanted first.
export class Loader {
  constructor(arrived, failed) {
    this.queue = []; this.idle = []; this.jobs = new Map(); this.number = 0; this.arrived = arrived; this.failed = failed;
    for (let i = 0; i < Math.max(2, Math.min(4, navigator.hardwareConcurrency || 2)); i += 1) {
      const worker = new Worker('worker.js');
      worker.onmessage = ({ data }) => this.answer(worker, data);
      this.idle.push(worker);
    }
  }

  get busy() { return this.jobs.size + this.queue.length; }

  ask(path, rank, about) { this.queue.push({ path, rank, about }); this.next(); }

  // Forget what is not wanted any more.
  keep(wanted) { const gone = this.queue.filter((job) => !wanted(job)); this.queue = this.queue.filter(wanted); return gone; }

  next() {
    while (this.idle.length && this.queue.length) {
      let best = 0;
      this.queue.forEach((job, i) => { if (job.rank > this.queue[best].rank) best = i; });
      const [job] = this.queue.splice(best, 1), worker = this.idle.pop();
      this.number += 1; this.jobs.set(this.number, job);
      worker.postMessage({ id: this.number, path: new URL(`data/${job.path}`, document.baseURI).href, headers, column: job.about.column, stride: job.about.stride });
    }
  }

  answer(worker, data) {
    const job = this.jobs.get(data.id);
    if (data.blocks) this.arrived(job, data.blocks);
    if (!data.end) return;
    traffic.requests += 1; traffic.bytes += data.bytes;
    this.jobs.delete(data.id); this.idle.push(worker);
    if (data.fault) this.failed(job, data.fault, data.status);
    this.next();
    if (!this.busy) this.arrived(job, []); // a frame may have come between the last block and its end
  }
}
