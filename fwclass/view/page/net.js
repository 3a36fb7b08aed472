// Requests of the scene's data; the token goes as a header.
let token = '';
export const traffic = { requests: 0, bytes: 0 };
export const useToken = (text) => { token = text; };

export async function json(path) {
  let answer;
  try { answer = await fetch(`data/${path}`, { headers: token ? { 'X-Fwclass-Token': token } : {} }); } catch {
    throw new Error('The server does not answer: it was ended, or this machine slept. If it was fwclass view, start that again and open the address that it prints.');
  }
  const text = await answer.text();
  traffic.requests += 1; traffic.bytes += text.length;
  let value;
  try { value = JSON.parse(text); } catch { value = { error: `not here (${answer.status})` }; }
  if (!answer.ok || value.error) throw Object.assign(new Error(value.error || `status ${answer.status}`), { status: answer.status });
  return value;
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
      worker.postMessage({ id: this.number, path: new URL(`data/${job.path}`, document.baseURI).href, token, column: job.about.column, stride: job.about.stride });
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
  }
}
