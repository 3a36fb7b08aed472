// For who has no mouse: a cross that keys move over the cloud or its section, and a click where it stands.
import { $ } from './panel.js';

const STEP = 10; // pixels that an arrow moves it, and one with shift
export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Crosshair {
  // `page`: canvases, halves, press, led.
  constructor(page) { Object.assign(this, page); this.over = null; }

  // Over the cloud, then over the section where one is drawn, then away; in the middle of what it comes to.
  next() {
    const drawn = this.canvases.filter((c) => c.clientHeight);
    this.over = drawn[drawn.indexOf(this.over) + 1] || null;
    if (this.over) [this.x, this.y] = [Math.floor(this.over.clientWidth / (2 * this.halves())), this.over.clientHeight >> 1];
    this.show();
  }

  away() { this.over = null; this.show(); }

  move([right, down], fine) {
    this.canvases[0].focus(); // Enter is for the crosshair, and not for the button that was pressed last
    this.x += right * (fine ? 1 : STEP); this.y += down * (fine ? 1 : STEP); this.show();
    this.led(this.x, this.y);
  }

  enter() { this.press(this.over, this.x, this.y); }

  // Inside its canvas, whatever size that has by now.
  show() {
    const at = this.over;
    if (at && !at.clientHeight) this.over = null;
    $('cross').hidden = !this.over;
    if (!this.over) return;
    this.x = Math.max(0, Math.min(at.clientWidth - 1, this.x)); this.y = Math.max(0, Math.min(at.clientHeight - 1, this.y));
    const box = at.getBoundingClientRect(), stage = $('stage').getBoundingClientRect();
    $('cross').style.left = `${box.left - stage.left + this.x}px`; $('cross').style.top = `${box.top - stage.top + this.y}px`;
  }
}
