// The time line under the picture: of a session its last minutes, in which one looks back while it runs; of a
// recording all of it, along which the replay is moved. Marks of stories, changes and losses stand in it.

import { drawFlag, fitted } from "./chart.js";
import { colours } from "./colours.js";
import { byId, clock, clockText } from "./common.js";
import { refusals } from "./roles.js";
import { MARK_COLOURS } from "./stories.js";

const SPANS_S = [60, 120, 300, 600, 1800, 3600];
const STEP_S = 10;
const BEFORE_MARK_MS = 1000;
const LEAST_BACK_MS = 50;
const SEEK_EVERY_MS = 100;
const CONTROLS = ["back", "earlier", "later", "hold", "now"];

/** 80 s as "1 min 20 s". */
export function agoText(seconds) {
  const whole = Math.round(seconds), minutes = Math.floor(whole / 60);
  return minutes ? `${minutes} min ${whole % 60} s` : `${whole} s`;
}

export class Timeline {
  #backMs = 0; // how far back it is looked; 0 is now
  #heldMs = null; // the time that stands, if one does
  #isDragged = false; // the slider, along a recording
  #soughtAt = 0;
  #marks = "";
  #context = byId("timeline-strip").getContext("2d");

  /** send(command) asks the session for what a replay is to do. */
  constructor(live, past, display, send) {
    Object.assign(this, { live, past, display, send });
    byId("back").addEventListener("input", () => this.#moveTo(Number(byId("back").value), true));
    byId("back").addEventListener("change", () => this.#moveTo(Number(byId("back").value), false));
    byId("earlier").addEventListener("click", () => this.step(1));
    byId("later").addEventListener("click", () => this.step(-1));
    byId("now").addEventListener("click", () => (this.#replay ? this.send({ replay: { stop: true } }) : this.toNow()));
    byId("hold").addEventListener("click", () => this.#hold());
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

  /** The replay that runs in place of a session, if one does. */
  get #replay() {
    const replay = this.live.news.session?.replay;
    return replay?.file ? replay : null;
  }

  /** Seconds from the beginning of a recording, or behind now; while the slider is dragged, not too often. */
  #moveTo(seconds, isDragged) {
    if (!this.#replay) {
      this.lookBack(-1000 * seconds);
      return;
    }
    this.#isDragged = isDragged;
    byId("back-text").textContent = clockText(seconds);
    if (isDragged && performance.now() - this.#soughtAt < SEEK_EVERY_MS) return;
    this.#soughtAt = performance.now();
    this.send({ replay: { position_s: seconds } });
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
    if (this.#replay) this.send({ replay: { skip_s: -direction * STEP_S } });
    else this.lookBack(this.#backMs + direction * 1000 * STEP_S);
  }

  toNow() {
    this.#backMs = 0;
    this.#heldMs = null;
    this.#showPicture(this.live);
    this.show();
  }

  /** Let the time that is looked at stand, or go on. */
  #hold() {
    if (this.#replay) {
      this.send({ replay: { paused: !this.#replay.paused } });
      return;
    }
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
    picture.nowMs = (at) => this.#heldMs ?? this.live.nowMs(at) - this.#backMs;
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
    const nowMs = this.#liveMs(), replay = this.#replay, back = byId("back");
    const span = SPANS_S.find((each) => each >= (nowMs - this.past.oldestMs) / 1000 || 0) ?? SPANS_S.at(-1);
    const [low, high, at] = replay ? [0, replay.duration_s, replay.position_s] : [-span, 0, -this.#backMs / 1000];
    const words = replay ? `${clockText(at)} / ${clockText(high)}` : this.#backMs ? `Looking back ${agoText(-at)}: ${clock(nowMs - this.#backMs)}` : "Now";
    if (!this.#isDragged) {
      Object.assign(back, { min: low, max: high, value: at });
      back.setAttribute("aria-valuetext", words);
      byId("back-text").textContent = words;
    }
    back.setAttribute("aria-label", replay ? "Position in the recording" : "Look back");
    for (const id of CONTROLS) byId(id).disabled = replay ? "replay" in refusals(this.live.news) : id === "now" && !this.#backMs;
    byId("hold").textContent = !replay ? "Hold" : replay.paused ? "Play" : "Pause";
    byId("hold").setAttribute("aria-pressed", String(replay ? replay.paused : this.#heldMs !== null));
    byId("now").textContent = replay ? "Back to a session" : "Back to now";
    document.documentElement.toggleAttribute("data-back", this.#backMs > 0);
    this.#showMarks();
    const zeroMs = nowMs - (replay ? 1000 * at : 0);
    this.#draw(zeroMs + 1000 * low, zeroMs + 1000 * high);
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

  /** What is kept and what was lost between two times, and the marks there. */
  #draw(fromMs, toMs) {
    const context = this.#context, { width, height } = fitted(context);
    const x = (ms) => ((ms - fromMs) / (toMs - fromMs)) * width, base = height - 1, second = x(fromMs + 1000);
    context.fillStyle = colours.grid;
    context.fillRect(x(this.past.oldestMs), base - 2, x(this.past.latestMs) - x(this.past.oldestMs), 2);
    context.fillStyle = colours.bad;
    for (const { ms, lost, messages } of this.past.seconds) {
      const share = lost / (lost + messages || 1);
      if (share > 0) context.fillRect(x(ms) - second, base - 2 - share * (height - 5), Math.max(second, 1), share * (height - 5));
    }
    for (const { t_utc_ms: ms, kind } of this.live.news.marks ?? []) if (ms >= fromMs) drawFlag(context, x(ms), 1, base, colours[MARK_COLOURS[kind]]);
    if (!this.#backMs) return;
    context.fillStyle = colours.ink;
    context.fillRect(x(this.#liveMs() - this.#backMs) - 1, 0, 2, height);
  }
}
