// A small chart on a canvas: axes with round numbers, lines, bars, dots.

import { colours, faded } from "./colours.js";
import { byId, line } from "./common.js";
import { nice } from "./ground.js";

const LEAST_LEFT = 38, GAP = 5, RIGHT = 8, TOP = 6, BOTTOM = 17;

/** Empty a canvas that is as large as its place, and give its width and height in pixels of the page. */
export function fitted(context) {
  const { canvas } = context, { clientWidth, clientHeight } = canvas, dpr = devicePixelRatio || 1;
  const width = Math.round(clientWidth * dpr), height = Math.round(clientHeight * dpr);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  context.setTransform(dpr, 0, 0, dpr, 0, 0);
  context.clearRect(0, 0, clientWidth, clientHeight);
  return { width: clientWidth, height: clientHeight };
}

/** An upright line with a flag at its top. */
export function drawFlag(context, x, top, bottom, colour) {
  context.fillStyle = colour;
  context.fillRect(x - 0.5, top, 1, bottom - top);
  context.beginPath();
  for (const [dx, dy] of [[0, 0], [7, 3.5], [0, 7]]) context.lineTo(x + dx, top + dy);
  context.fill();
}

export class Chart {
  #low = 0;
  #high = 1;
  #bottom = 0;
  #top = 1;
  #left = LEAST_LEFT; // of the axis: room for the widest of its words

  constructor(id) {
    this.canvas = byId(id);
    this.context = this.canvas.getContext("2d");
  }

  /** Begin anew with those axes; `unit` stands at the right end of the lower one. */
  begin({ low, high, bottom = 0, top, unit, xTick = String, yTick = String, xStep }) {
    Object.assign(this, fitted(this.context));
    [this.#low, this.#high, this.#bottom, this.#top] = [low, high, bottom, top];
    this.#axes(unit, xTick, yTick, xStep);
  }

  x(value) {
    return this.#left + ((value - this.#low) / (this.#high - this.#low)) * (this.width - this.#left - RIGHT);
  }

  y(value) {
    return this.height - BOTTOM - ((value - this.#bottom) / (this.#top - this.#bottom)) * (this.height - TOP - BOTTOM);
  }

  #axes(unit, xTick, yTick, xStep) {
    const { context } = this;
    context.font = colours.font;
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    context.fillStyle = colours.quiet;
    context.textAlign = "right";
    context.textBaseline = "middle";
    const levels = ticks(this.#bottom, this.#top, Math.max(2, Math.floor((this.height - TOP - BOTTOM) / 26)));
    this.#left = Math.max(LEAST_LEFT, ...levels.map((value) => context.measureText(yTick(value)).width + 2 * GAP));
    for (const value of levels) {
      const y = Math.round(this.y(value)) + 0.5;
      line(context, this.#left, y, this.width - RIGHT, y);
      context.fillText(yTick(value), this.#left - GAP, Math.min(y, this.height - BOTTOM - 4));
    }
    context.textBaseline = "alphabetic";
    const unitWidth = context.measureText(unit).width;
    for (const value of ticks(this.#low, this.#high, Math.max(2, Math.floor(this.width / 70)), xStep)) {
      const x = this.x(value), words = xTick(value), half = context.measureText(words).width / 2;
      if (x + half > this.width - RIGHT - unitWidth - 6) continue;
      context.textAlign = "center";
      context.fillText(words, x, this.height - 4);
    }
    context.textAlign = "right";
    context.fillText(unit, this.width - RIGHT, this.height - 4);
  }

  line(points, colour, { dashed = false, width = 1.5 } = {}) {
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.setLineDash(dashed ? [4, 3] : []);
    context.beginPath();
    let down = false;
    for (const [x, y] of points) {
      if (y === null || !Number.isFinite(y)) { down = false; continue; }
      context[down ? "lineTo" : "moveTo"](this.x(x), this.y(Math.min(y, this.#top)));
      down = true;
    }
    context.stroke();
    context.setLineDash([]);
  }

  /** Marks above the top where points are further up, the highest with its value. */
  cutOff(points, colour, words) {
    const { context } = this, above = points.filter(([, y]) => y > this.#top), y = this.y(this.#top);
    context.fillStyle = colour;
    for (const [x] of above) {
      context.beginPath();
      for (const [dx, dy] of [[0, -1], [3, 4], [-3, 4]]) context.lineTo(this.x(x) + dx, y + dy);
      context.fill();
    }
    if (!above.length) return;
    const [x, most] = above.reduce((a, b) => (b[1] > a[1] ? b : a)), left = this.x(x) > this.width / 2;
    context.font = colours.font;
    context.textAlign = left ? "right" : "left";
    context.textBaseline = "middle";
    context.fillText(words(most), this.x(x) + (left ? -6 : 6), y + 6);
    context.textBaseline = "alphabetic";
  }

  /** Between two curves, each as points of equal x. */
  band(lower, upper, colour) {
    const { context } = this;
    context.fillStyle = colour;
    context.beginPath();
    upper.forEach(([x, y], i) => context[i ? "lineTo" : "moveTo"](this.x(x), this.y(Math.min(y, this.#top))));
    for (const [x, y] of [...lower].reverse()) context.lineTo(this.x(x), this.y(Math.max(y, this.#bottom)));
    context.closePath();
    context.fill();
  }

  bars(low, width, values, colour) {
    this.context.fillStyle = colour;
    values.forEach((value, i) => {
      const x0 = this.x(low + i * width), x1 = this.x(low + (i + 1) * width), y = this.y(Math.min(value, this.#top));
      const gap = x1 - x0 > 6 ? 1 : 0;
      if (value > 0) this.context.fillRect(x0, y, Math.max(x1 - x0 - gap, 1), this.y(this.#bottom) - y);
    });
  }

  /** Dots with their error bars: [x, y, low, high]. */
  dots(points, colour) {
    const { context } = this;
    context.fillStyle = colour;
    context.strokeStyle = colour;
    context.lineWidth = 1;
    for (const [x, y, low, high] of points) {
      line(context, this.x(x), this.y(low), this.x(x), this.y(high));
      context.beginPath();
      context.arc(this.x(x), this.y(y), 2.4, 0, 2 * Math.PI);
      context.fill();
    }
  }

  /** An upright line with a flag, where something was changed. */
  flag(value, colour) {
    drawFlag(this.context, this.x(value), TOP, this.height - BOTTOM, colour);
  }

  /** Words in the upper right corner, on a ground of their own, cut to the width. */
  note(words, colour) {
    const { context } = this, most = this.width - this.#left - RIGHT - 6;
    context.font = colours.font;
    context.textAlign = "right";
    context.textBaseline = "middle";
    let shown = words;
    while (shown.length > 1 && context.measureText(shown).width > most) shown = `${shown.slice(0, -2)}…`;
    context.fillStyle = faded(colours.panel, 0.85);
    context.fillRect(this.width - RIGHT - context.measureText(shown).width - 4, TOP, context.measureText(shown).width + 4, 14);
    context.fillStyle = colour;
    context.fillText(shown, this.width - RIGHT - 2, TOP + 7);
    context.textBaseline = "alphabetic";
  }

  /** What is marked, for who does not see it; added to what the chart is. */
  tell(words) {
    this.label ??= this.canvas.getAttribute("aria-label");
    const label = words.length ? `${this.label}. ${words.join(". ")}.` : this.label;
    if (this.canvas.getAttribute("aria-label") !== label) this.canvas.setAttribute("aria-label", label);
  }

  /** Words in the middle, where there is nothing to draw. */
  say(words) {
    const { context } = this;
    context.font = colours.font;
    context.fillStyle = colours.quiet;
    context.textAlign = "center";
    context.fillText(words, (this.#left + this.width - RIGHT) / 2, this.height / 2);
  }
}

/** Round numbers from low to high, about so many. */
function ticks(low, high, count, step = nice((high - low) / count)) {
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + step * 1e-6; value += step) found.push(+value.toPrecision(12));
  return found;
}
