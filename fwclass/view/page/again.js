import { json } from './net.js';
import { $, element } from './panel.js';

// The run's last command: a button where it may be started from here, else the words to type.
export class Again {
  constructor(page) {
    Object.assign(this, page);
    $('run').onclick = () => this.ask('run.json', {}); $('stop').onclick = () => this.ask('stop.json', {});
  }

  async ask(path, body) { clearTimeout(this.timer); try { await this.show(await json(path, body)); } catch (e) { $('run-says').textContent = e.message; } }
  look() { return this.ask('run.json'); }

  async show(state) {
    $('run').hidden = !state.allowed || !state.command; $('run').disabled = state.running; $('stop').hidden = !state.running;
    $('command').textContent = state.command;
    $('run-says').textContent = state.why || (state.running ? 'The run is under way.' : state.code !== null ? `The run ended: ${state.word}.` : state.allowed ? 'Starts the last command of this run once more:' : 'A run learns from this. Type, or start the viewer with --allow-run:');
    $('lines').hidden = !state.lines.length; $('lines').replaceChildren(...state.lines.slice(-12).map((line) => element('div', line)));
    if (state.running) { this.running = true; this.timer = setTimeout(() => this.look(), 700); return; }
    const delivered = this.running && [0, 3, 4].includes(state.code);
    this.running = false;
    if (delivered) await this.take();
  }
}
