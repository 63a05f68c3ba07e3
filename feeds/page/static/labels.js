// Words beside marks: each where it covers no other and no site; what finds no place is left out.

import { colours } from "./colours.js";
import { line } from "./common.js";

const NEAR = [[10, -9], [10, 9], [-10, -9], [-10, 9], [12, 0], [-12, 0], [0, -16], [0, 16]];
const FAR = [22, 36, 52, 70, 90].flatMap((r) => [[1, 0.4], [1, -0.4], [-1, 0.4], [-1, -0.4], [0.7, 0.8], [0.7, -0.8], [-0.7, 0.8], [-0.7, -0.8]].map(([x, y]) => [r * x, r * y]));
const LEADER_FROM = 20; // pixels off, from where a line says whose words these are
const GAP = 2;
const widths = new Map();
const MOST_WIDTHS = 5000;

export class Labels {
  /** `placed` are rectangles that are taken already: [left, top, right, bottom, words, or "" of a mark, and a colour if they are written over marks]. */
  constructor(context, view, placed = []) {
    this.context = context;
    this.view = view;
    this.placed = [...placed];
    this.high = parseFloat(colours.font) + 3;
    context.font = colours.font;
    context.textBaseline = "middle";
    context.lineJoin = "round";
  }

  /** A mark that no words may cover. */
  block(x, y, half) {
    this.placed.push([x - half, y - half, x + half, y + half, ""]);
  }

  /** Write words that were placed so on another layer again, over the marks. */
  writeAgain() {
    for (const [left, , , bottom, words, colour] of [...this.placed]) if (colour) this.#draw(words, left + GAP, bottom - this.high / 2, colour);
  }

  /** Words about a fixed place, unless it is taken. */
  at(words, x, y, colour) {
    const left = x - this.#wide(words) / 2;
    if (this.#isFree(this.#box(words, left, y))) this.#write(words, left, y, colour);
  }

  /** Words beside a mark, further away with a line to it if `far` is allowed, and if `over`, over all marks; false if there is no place. */
  beside(words, x, y, colour, { size = 1, far = false, over = false } = {}) {
    const wide = this.#wide(words);
    for (const [dx, dy] of far ? [...NEAR, ...FAR] : NEAR) {
      const left = x + size * dx - (dx < 0 ? wide : dx === 0 ? wide / 2 : 0), middle = y + size * dy;
      if (!this.#isFree(this.#box(words, left, middle))) continue;
      if (Math.hypot(dx, dy) > LEADER_FROM) this.#lead(x, y, dx < 0 ? left + wide : left, middle, colour);
      this.#write(words, left, middle, colour, over);
      return true;
    }
    return false;
  }

  #box(words, left, middle) {
    return [left - GAP, middle - this.high / 2, left + this.#wide(words) + GAP, middle + this.high / 2, words];
  }

  #isFree([left, top, right, bottom]) {
    if (left < 0 || top < 0 || right > this.view.width || bottom > this.view.height) return false;
    return !this.placed.some((p) => left < p[2] && right > p[0] && top < p[3] && bottom > p[1]);
  }

  #wide(words) {
    const key = `${this.context.font}|${words}`;
    if (widths.size > MOST_WIDTHS) widths.clear();
    if (!widths.has(key)) widths.set(key, this.context.measureText(words).width);
    return widths.get(key);
  }

  #lead(x, y, toX, toY, colour) {
    this.context.strokeStyle = colour;
    this.context.lineWidth = 1;
    line(this.context, x, y, toX, toY);
  }

  #write(words, left, middle, colour, over = false) {
    this.placed.push([...this.#box(words, left, middle), over && colour]);
    this.#draw(words, left, middle, colour);
  }

  #draw(words, left, middle, colour) {
    this.context.textAlign = "left";
    drawWords(this.context, words, left, middle, colour);
  }
}

/** Words with a halo, so that lines do not cut them. */
export function drawWords(context, words, x, y, colour) {
  context.lineWidth = 3;
  context.strokeStyle = colours.sea;
  context.strokeText(words, x, y);
  context.fillStyle = colour;
  context.fillText(words, x, y);
}
