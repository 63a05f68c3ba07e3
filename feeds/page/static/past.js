// What was to be seen in the last minutes: the frames as they came, and a picture of any time among them.

import { Picture } from "./picture.js";

const MOST_OCTETS = 48 << 20;
const MOST_FRAMES = 6000; // ten minutes, at ten a second
const NOTED_EVERY = 50; // frames
const REACH_MS = 62_000; // plots fade, and tracks are kept, no longer than a minute
const MOST_SECONDS = 600;

export class Past {
  seconds = []; // {ms, lost, messages} of the strips, further back than those reach
  #frames = []; // {ms, buffer, noted}; noted, of some, is the news and the names that were known then
  #first = 0; // of those that are kept
  #octets = 0;
  #shown = null; // {picture, index}: the last that was asked for
  #sinceNoted = 0;

  constructor(reader) {
    this.reader = reader; // knows the layouts of what it has read before
  }

  clear() {
    this.#frames = [];
    this.seconds = [];
    this.#first = this.#octets = this.#sinceNoted = 0;
    this.#shown = null;
  }

  get oldestMs() {
    return this.#frames[this.#first]?.ms ?? NaN;
  }

  get latestMs() {
    return this.#frames.at(-1)?.ms ?? NaN;
  }

  /** A frame that the live picture has just taken; after a leap back in time all before it is forgotten. */
  keep(buffer, frame, live) {
    if (frame.nowMs < this.latestMs) this.clear();
    const noted = frame.isSnapshot || this.#sinceNoted >= NOTED_EVERY || !this.#frames.length;
    this.#sinceNoted = noted ? 0 : this.#sinceNoted + 1;
    this.#frames.push({ ms: frame.nowMs, buffer, noted: noted ? { news: { ...live.news }, names: live.droneNames } : null });
    this.#octets += buffer.byteLength;
    this.#keepSeconds(live.seconds);
    while (this.#octets > MOST_OCTETS || this.#frames.length - this.#first > MOST_FRAMES) this.#dropOldest();
    if (this.#first > MOST_FRAMES) this.#compact();
  }

  #keepSeconds(seconds) {
    const latest = this.seconds.at(-1)?.ms ?? -Infinity;
    for (const { t_utc_ms: ms, lost, messages } of seconds) if (ms > latest) this.seconds.push({ ms, lost, messages });
    if (this.seconds.length > MOST_SECONDS) this.seconds.splice(0, this.seconds.length - MOST_SECONDS);
  }

  #dropOldest() {
    this.#octets -= this.#frames[this.#first].buffer.byteLength;
    this.#frames[this.#first++] = null;
  }

  #compact() {
    this.#frames.splice(0, this.#first);
    if (this.#shown) this.#shown.index -= this.#first;
    this.#first = 0;
  }

  /** What was to be seen at a time, that of the oldest frame at the least. */
  pictureAt(ms) {
    const index = Math.max(this.#indexAt(ms), this.#first);
    if (!this.#shown || index < this.#shown.index || this.#shown.index < this.#first) this.#shown = this.#begunAt(index, ms);
    const { picture } = this.#shown;
    while (this.#shown.index < index) picture.take(this.reader.read(this.#frames[++this.#shown.index].buffer), 0);
    return picture;
  }

  /** The last frame that had come by then; frames are in the order of time. */
  #indexAt(ms) {
    let low = this.#first, high = this.#frames.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.#frames[middle].ms <= ms) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** A picture that has taken a frame from so long before that nothing of what came earlier is still seen. */
  #begunAt(index, ms) {
    let from = this.#indexAt(ms - REACH_MS);
    while (from > this.#first && !this.#frames[from].noted) from--;
    while (from < index && !this.#frames[from].noted) from++; // those before were dropped
    const picture = new Picture(), noted = this.#frames[from].noted ?? { news: {}, names: [] };
    Object.assign(picture.news, noted.news);
    picture.droneNames = noted.names;
    picture.take(this.reader.read(this.#frames[from].buffer), 0);
    return { picture, index: from };
  }
}
