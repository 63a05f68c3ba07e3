// What there is to see: plots that fade, drones, tracks, and the session's time between two updates.

import { FALSE_ALARM, Kind, PlotFlag, TrackFlag } from "./frames.js";
import { noteReport, TRACK_KEPT_MS } from "./track_states.js";

const CAPACITY = 1 << 16; // plots; a power of two
const MASK = CAPACITY - 1;
const LONGEST_FADE_MS = 60_000;
const TRAIL = 40;
export const UNKNOWN = -2; // whose plot it is, while that is not told

const FLOATS = ["east_m", "north_m", "range_m", "azimuth_deg", "elevation_deg", "height_m", "snr_db", "latency_ms",
  "true_east_m", "true_north_m", "true_range_m", "true_azimuth_deg", "true_elevation_deg"];
const TELLING = ["t_utc_ms", "sensor", "range_m", "azimuth_deg"];

/** Plots in the order in which they came; the oldest give way. Row i lies at i & MASK. */
export class Plots {
  begin = 0;
  end = 0;
  shift = 0; // of a plot's number to its row
  t_utc_ms = new Float64Array(CAPACITY);
  shown_ms = new Float64Array(CAPACITY); // when it arrived
  sensor = new Uint16Array(CAPACITY);
  flags = new Uint8Array(CAPACITY);
  drone = new Int32Array(CAPACITY);
  merged = new Uint8Array(CAPACITY);

  constructor() {
    for (const name of FLOATS) this[name] = new Float32Array(CAPACITY);
  }

  clear() {
    this.begin = this.end = 0;
  }

  /** Rows of a section; `first` is the number of the first. */
  add(columns, rows, first) {
    this.shift = this.end - first;
    for (let i = 0; i < rows; i++) {
      const at = this.end++ & MASK;
      for (const name of FLOATS) this[name][at] = columns[name] ? columns[name][i] : NaN;
      this.t_utc_ms[at] = columns.t_utc_ms[i];
      this.shown_ms[at] = columns.t_utc_ms[i] + (columns.latency_ms[i] || 0);
      this.sensor[at] = columns.sensor[i];
      this.flags[at] = columns.flags[i];
      this.drone[at] = columns.drone ? columns.drone[i] : UNKNOWN;
      this.merged[at] = columns.merged ? columns.merged[i] : 0;
    }
    this.begin = Math.max(this.begin, this.end - CAPACITY);
  }

  /** What is true of plots that were added by their numbers. */
  addTruths(columns, rows, first) {
    for (let i = 0; i < rows; i++) {
      const row = first + i + this.shift;
      if (row < this.begin || row >= this.end) continue;
      const at = row & MASK;
      for (const name of FLOATS) if (columns[name]) this[name][at] = columns[name][i];
      this.drone[at] = columns.drone[i];
      this.merged[at] = columns.merged[i];
    }
  }

  forgetTruth() {
    this.drone.fill(UNKNOWN);
    this.merged.fill(0);
  }

  forgetBefore(ms) {
    while (this.begin < this.end && this.shown_ms[this.begin & MASK] < ms) this.begin++;
  }

  at(row) {
    return row & MASK;
  }

  holds(row) {
    return row >= this.begin && row < this.end;
  }

  /** What tells a plot from others, wherever it lies. */
  told(at) {
    return TELLING.map((name) => this[name][at]);
  }

  /** The row of such a plot; -1 if it is not there. */
  find(told) {
    for (let row = this.begin; row < this.end; row++) {
      if (TELLING.every((name, i) => Object.is(this[name][row & MASK], told[i]))) return row;
    }
    return -1;
  }

  isBearing(at) {
    return (this.flags[at] & PlotFlag.BEARING) !== 0;
  }

  isNowhere(at) {
    return (this.flags[at] & PlotFlag.NOWHERE) !== 0;
  }

  isFalse(at) {
    return this.drone[at] === FALSE_ALARM;
  }
}

/** The scene with its sensors as they cover now. */
function withCovers({ scene, covers }) {
  return { ...scene, sensors: scene.sensors.map((sensor) => ({ ...sensor, ...covers?.[sensor.id] })) };
}

export class Picture {
  plots = new Plots();
  lost = new Plots();
  drones = null; // columns, with rows
  droneNames = [];
  unseen = {}; // why no sensor sees them, of drones by name
  droneClasses = {}; // of those that are no drones, by number
  tracks = new Map();
  news = {};
  score = null; // of the tracker under test, where the truth is shown
  seconds = [];
  pace = 1;
  framesTaken = 0;
  octetsTaken = 0;
  #baseMs = 0;
  #baseAt = 0;
  #shownMs = 0;

  /** Take in a frame; the keys of its news that changed. */
  take(frame, at) {
    this.framesTaken++;
    this.octetsTaken += frame.octets;
    if (frame.isSnapshot) this.#forget();
    this.#setClock(frame.nowMs, at);
    const changed = new Set(frame.isSnapshot ? ["snapshot"] : []);
    for (const section of frame.sections) this.#takeSection(section, frame, at, changed);
    const oldest = frame.nowMs - LONGEST_FADE_MS;
    this.plots.forgetBefore(oldest);
    this.lost.forgetBefore(oldest);
    for (const [id, track] of this.tracks) if (track.t_utc_ms < frame.nowMs - TRACK_KEPT_MS) this.tracks.delete(id);
    return changed;
  }

  #takeSection({ kind, news, rows, first, columns }, frame, at, changed) {
    if (kind === Kind.NEWS) this.#takeNews(news, changed);
    else if (kind === Kind.TRUE_NEWS) {
      [this.droneNames, this.droneClasses, this.unseen] = [news.drones ?? this.droneNames, news.classes ?? this.droneClasses, news.unseen ?? this.unseen];
      if (news.score) [this.score] = [news.score, changed.add("score")];
    }
    else if (kind === Kind.PLOTS) this.plots.add(columns, rows, first);
    else if (kind === Kind.PLOT_TRUTHS) this.plots.addTruths(columns, rows, first);
    else if (kind === Kind.LOST_PLOTS) this.lost.add(columns, rows, 0);
    else if (kind === Kind.DRONES) this.drones = { ...columns, rows, ms: frame.nowMs };
    else if (kind === Kind.TRACKS) this.#takeTracks(columns, rows);
  }

  #takeNews({ seconds, ...news }, changed) {
    Object.assign(this.news, news);
    if ((news.covers || news.scene) && this.news.scene) this.news.scene = withCovers(this.news);
    for (const key of Object.keys(news)) changed.add(key);
    if (seconds) {
      this.seconds = [...this.seconds, ...seconds].slice(-120);
      changed.add("seconds");
    }
    const clock = this.news.session?.clock;
    this.pace = clock?.paused ? 0 : (clock?.speed ?? 1);
  }

  #takeTracks(columns, rows) {
    for (let i = 0; i < rows; i++) {
      const id = columns.track[i];
      if (columns.flags[i] & TrackFlag.ENDED) {
        this.tracks.delete(id);
        continue;
      }
      const track = this.tracks.get(id) ?? { id, trail: [] };
      track.name = this.news.track_names?.[id] ?? String(id);
      noteReport(track, columns.t_utc_ms[i]);
      for (const name of ["t_utc_ms", "east_m", "north_m", "velocity_east_m_s", "velocity_north_m_s", "flags"]) track[name] = columns[name][i];
      track.trail.push(track.east_m, track.north_m);
      if (track.trail.length > 2 * TRAIL) track.trail.splice(0, 2);
      this.tracks.set(id, track);
    }
  }

  #forget() {
    this.plots.clear();
    this.lost.clear();
    this.drones = null;
    this.droneNames = [];
    this.droneClasses = this.unseen = {};
    this.score = null;
    this.tracks.clear();
    this.news = {};
    this.seconds = [];
    this.#shownMs = 0;
  }

  forgetTruth() {
    this.plots.forgetTruth();
    this.lost.clear();
    this.drones = this.score = null;
  }

  #setClock(nowMs, at) {
    this.#baseMs = nowMs;
    this.#baseAt = at;
    if (Math.abs(nowMs - this.#shownMs) > 1000 * Math.max(this.pace, 1)) this.#shownMs = nowMs;
  }

  /** The session's time: runs on between updates, never back, and not far when updates stay out. */
  nowMs(at) {
    const passed = Math.min(Math.max(at - this.#baseAt, 0), 500);
    this.#shownMs = Math.max(this.#shownMs, this.#baseMs + passed * this.pace);
    if (this.pace === 0) this.#shownMs = this.#baseMs;
    return this.#shownMs;
  }
}
