// The time line of the last minutes: marks of stories, changes and losses, and looking back while it runs.

import { colours } from "./colours.js";
import { byId } from "./common.js";
import { MARK_COLOURS } from "./stories.js";

const SPANS_S = [60, 120, 300, 600, 1800, 3600];
const STEP_S = 5;
const BEFORE_MARK_MS = 1000;
const LEAST_BACK_MS = 50;
const clock = (ms) => new Date(ms).toISOString().slice(11, 19);

/** 80 s as "1 min 20 s". */
export function agoText(seconds) {
  const whole = Math.round(seconds), minutes = Math.floor(whole / 60);
  return minutes ? `${minutes} min ${whole % 60} s` : `${whole} s`;
}

export class Timeline {
  #backMs = 0; // how far back it is looked; 0 is now
  #heldMs = null; // the time that stands, if one does
  #span = SPANS_S[0];
  #marks = "";
  #context = byId("timeline-strip").getContext("2d");

  constructor(live, past, display) {
    Object.assign(this, { live, past, display });
    byId("back").addEventListener("input", () => this.lookBack(-1000 * Number(byId("back").value)));
    byId("now").addEventListener("click", () => this.toNow());
    byId("hold").addEventListener("click", () => this.hold());
    byId("marks").addEventListener("change", () => {
      const ms = Number(byId("marks").value);
      byId("marks").value = "";
      this.lookBack(this.#liveMs() - ms + BEFORE_MARK_MS);
    });
    new ResizeObserver(() => this.show()).observe(this.#context.canvas);
  }

  get isBack() {
    return this.#backMs > 0;
  }

  /** Look at what was so long ago, as far as it is kept; it goes on from there. */
  lookBack(ms) {
    const most = this.#liveMs() - this.past.oldestMs;
    this.#backMs = Math.min(ms, most) > LEAST_BACK_MS ? Math.min(ms, most) : 0;
    if (this.#heldMs !== null) this.#heldMs = this.#liveMs() - this.#backMs;
    if (!this.#backMs) this.toNow();
    else this.tick();
    this.show();
  }

  /** Some seconds further back, or with a negative number ahead. */
  step(direction) {
    this.lookBack(this.#backMs + direction * 1000 * STEP_S);
  }

  toNow() {
    this.#backMs = 0;
    this.#heldMs = null;
    this.#showPicture(this.live);
    this.show();
  }

  /** Let the time that is looked at stand, or go on. */
  hold() {
    this.#heldMs = this.#heldMs === null ? this.#liveMs() - this.#backMs : null;
    this.tick();
    this.show();
  }

  /** As often as frames come: bring what is looked at up to its time. */
  tick() {
    if (this.#heldMs !== null) this.#backMs = Math.max(this.#liveMs() - this.#heldMs, LEAST_BACK_MS + 1);
    if (!this.#backMs) return;
    const most = this.#liveMs() - this.past.oldestMs;
    if (this.#backMs > most) {
      this.#backMs = most; // what was looked at is kept no longer
      this.#heldMs = this.#heldMs === null ? null : this.#liveMs() - most;
    }
    const picture = this.past.pictureAt(this.#liveMs() - this.#backMs);
    picture.timeOf = (at) => this.#heldMs ?? this.live.nowMs(at) - this.#backMs;
    picture.pace = this.#heldMs === null ? this.live.pace : 0;
    this.#showPicture(picture);
  }

  #liveMs() {
    return this.live.nowMs(performance.now());
  }

  /** The same plot stays selected, wherever it lies in another picture. */
  #showPicture(picture) {
    const { display } = this, { selected } = display;
    if (display.picture === picture) return;
    const told = selected?.kind === "plot" ? display.picture.plots.told(selected.at) : null;
    display.picture = picture;
    if (told) display.selectPlot(picture.plots.find(told));
    display.redraw();
  }

  /** Words, slider and strip. */
  show() {
    const nowMs = this.#liveMs(), keptS = (nowMs - this.past.oldestMs) / 1000 || 0, back = byId("back");
    this.#span = SPANS_S.find((span) => span >= keptS) ?? SPANS_S.at(-1);
    back.min = -this.#span;
    back.value = -this.#backMs / 1000;
    const words = this.#backMs ? `Looking back ${agoText(this.#backMs / 1000)}` : "Now";
    back.setAttribute("aria-valuetext", words);
    byId("back-text").textContent = this.#backMs ? `${words}: ${clock(nowMs - this.#backMs)}` : "Now";
    byId("now").disabled = !this.#backMs;
    byId("hold").setAttribute("aria-pressed", String(this.#heldMs !== null));
    document.documentElement.toggleAttribute("data-back", this.#backMs > 0);
    this.#showMarks();
    this.#draw(nowMs);
  }

  /** The marks to choose from, the newest first. */
  #showMarks() {
    const marks = this.live.news.marks ?? [], told = marks.map(({ t_utc_ms: ms, words }) => `${ms} ${words}`).join("\n");
    if (told === this.#marks) return;
    this.#marks = told;
    const options = marks.map(({ t_utc_ms: ms, words }) => new Option(`${clock(ms)} ${words}`, ms)).reverse();
    byId("marks").replaceChildren(new Option(marks.length ? `Marks: ${marks.length}` : "No marks", ""), ...options);
    byId("marks").disabled = !marks.length;
  }

  #draw(nowMs) {
    const context = this.#context, { canvas } = context, dpr = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * dpr) || canvas.height !== Math.round(height * dpr)) {
      canvas.width = Math.round(width * dpr);
      canvas.height = Math.round(height * dpr);
    }
    context.setTransform(dpr, 0, 0, dpr, 0, 0);
    context.clearRect(0, 0, width, height);
    const x = (ms) => width + ((ms - nowMs) / 1000 / this.#span) * width, base = height - 1;
    context.fillStyle = colours.grid;
    context.fillRect(x(this.past.oldestMs), base - 2, width - x(this.past.oldestMs), 2);
    context.fillStyle = colours.bad;
    for (const { ms, lost, messages } of this.past.seconds) {
      const share = lost / (lost + messages || 1);
      if (share > 0) context.fillRect(x(ms) - width / this.#span, base - 2 - share * (height - 5), Math.max(width / this.#span, 1), share * (height - 5));
    }
    for (const { t_utc_ms: ms, kind } of this.live.news.marks ?? []) drawFlag(context, x(ms), base, colours[MARK_COLOURS[kind]]);
    if (!this.#backMs) return;
    context.fillStyle = colours.ink;
    context.fillRect(x(nowMs - this.#backMs) - 1, 0, 2, height);
  }
}

function drawFlag(context, x, base, colour) {
  if (x < 0) return;
  context.fillStyle = colour;
  context.fillRect(x - 0.75, 1, 1.5, base - 1);
  context.beginPath();
  for (const [dx, y] of [[0, 1], [8, 4.5], [0, 8]]) context.lineTo(x + dx, y);
  context.fill();
}
