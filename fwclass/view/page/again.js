import { json } from './net.js';
import { $, element } from './panel.js';

const EVERY = 4000; // ms between questions whether another page started the run

// The run's last command: a button where it may be started from here, else the words to type.
export class Again {
  // `page`: take, open, drawing.
  constructor(page) {
    Object.assign(this, page);
    $('run').onclick = () => this.ask('run.json', {}); $('stop').onclick = () => this.ask('stop.json', {});
  }

  async ask(path, body) {
    clearTimeout(this.timer);
    try { await this.show(await json(path, body)); } catch (e) {
      if (body) await this.look(); // it may be under way from another page
      if (!this.running) $('run-says').textContent = e.message;
    }
  }

  look() { return this.ask('run.json'); }

  later(ms) { this.timer = setTimeout(() => { if (this.open()) this.look(); }, ms); }

  async show(state) {
    $('run').hidden = !state.allowed || !state.command; $('run').disabled = state.running; $('stop').hidden = !state.running;
    if ($('command').textContent !== state.command) $('command').textContent = state.command; // what is marked for a copy stays so
    $('run-says').textContent = state.why || (state.running ? 'The run is under way.' : state.code !== null ? `The run ended: ${state.word}.` : state.allowed ? 'Starts the last command of this run once more:' : 'A run learns from this. Type, or start the viewer with --allow-run:');
    $('lines').hidden = !state.lines.length; $('lines').replaceChildren(...state.lines.slice(-16).map((line) => element('div', line)));
    const delivered = this.running && !state.running && [0, 3, 4].includes(state.code);
    this.running = state.running;
    if (state.running) this.later(700); else if (state.allowed) this.later(EVERY);
    if (delivered && !this.drawing()) await this.take(); // who draws is told of the new delivery, and takes it when done
  }
}
