// Where tracks, and with the truth drones, have been: lines that fade. And heights against range, of one sensor.

import { Chart } from "./chart.js";
import { colours, faded, sensorColour } from "./colours.js";
import { byId } from "./common.js";
import { nice } from "./ground.js";
import { dronePlace, trackPlace } from "./marks.js";
import { isSilent } from "./track_states.js";

const NOTED_EVERY_MS = 500;
const LONGEST_MS = 300_000;
const MOST_TRAILS = 2000;
const PARTS = 4; // of a trail, each fainter

export class Trails {
  #trails = new Map(); // "drone 3" or "track 12": ms, east, north in turns
  #notedMs = -Infinity;

  constructor(display, live) {
    Object.assign(this, { display, live, lengthMs: 0 });
    display.extras.push((context, view, _picture, nowMs) => this.#draw(context, view, nowMs));
    byId("trails").addEventListener("change", () => {
      this.lengthMs = 1000 * Number(byId("trails").value);
      display.refresh();
    });
  }

  /** Of what there are trails: "track 12", "drone 3". */
  get names() {
    return this.#trails.keys();
  }

  clear() {
    this.#trails.clear();
    this.#notedMs = -Infinity;
  }

  forgetTruth() {
    for (const name of this.#trails.keys()) if (name.startsWith("drone")) this.#trails.delete(name);
  }

  /** Note where everything is, twice a second of the session. */
  note(nowMs) {
    if (nowMs < this.#notedMs) this.clear();
    if (nowMs - this.#notedMs < NOTED_EVERY_MS) return;
    this.#notedMs = nowMs;
    const { tracks, drones } = this.live;
    for (const track of tracks.values()) if (!isSilent(track, nowMs)) this.#add(`track ${track.id}`, nowMs, trackPlace(track, nowMs));
    for (let i = 0; i < (drones?.rows ?? 0); i++) if (drones.gone_ms[i] === 0) this.#add(`drone ${drones.drone[i]}`, nowMs, dronePlace(drones, i, nowMs));
    for (const [name, trail] of this.#trails) if (trail.at(-3) < nowMs - LONGEST_MS) this.#trails.delete(name);
  }

  #add(name, nowMs, [east, north]) {
    const trail = this.#trails.get(name) ?? [];
    if (!trail.length && this.#trails.size >= MOST_TRAILS) return;
    trail.push(nowMs, east, north);
    while (trail[0] < nowMs - LONGEST_MS) trail.splice(0, 3);
    this.#trails.set(name, trail);
  }

  #draw(context, view, nowMs) {
    if (!this.lengthMs) return;
    const { truth, layers } = this.display;
    context.lineWidth = 1.4;
    context.lineJoin = "round";
    for (let part = 0; part < PARTS; part++) {
      const from = nowMs - (this.lengthMs * (part + 1)) / PARTS, to = nowMs - (this.lengthMs * part) / PARTS;
      for (const [kind, colour, shown] of [["track", colours.track, layers.tracks], ["drone", colours.truth, truth]]) {
        if (!shown) continue;
        context.strokeStyle = faded(colour, 0.75 * (1 - part / PARTS));
        context.beginPath();
        for (const [name, trail] of this.#trails) if (name.startsWith(kind)) trace(context, view, trail, from, to);
        context.stroke();
      }
    }
  }
}

function trace(context, view, trail, from, to) {
  let down = false;
  for (let i = 0; i < trail.length; i += 3) {
    if (trail[i] > to + NOTED_EVERY_MS) break; // one more, where the next part begins
    if (trail[i] < from) continue;
    context[down ? "lineTo" : "moveTo"](view.x(trail[i + 1]), view.y(trail[i + 2]));
    down = true;
  }
}

/** Heights above the site against the distance over ground from a sensor. */
export class Heights {
  #chart = new Chart("heights");

  show(display, chosen) {
    const { canvas } = this.#chart, { picture, truth, glowMs } = display, { scene } = picture.news;
    const number = scene?.sensors.findIndex(({ id }) => id === chosen) ?? -1;
    if (number < 0 || !canvas.checkVisibility()) return;
    const sensor = scene.sensors[number], nowMs = picture.nowMs(performance.now());
    const plots = plotHeights(picture, number, nowMs, glowMs, scene.site.height_m), drones = truth && picture.drones ? droneHeights(picture.drones, sensor, nowMs) : [];
    const most = usualMost([...plots, ...drones].map(([, height]) => height));
    this.#chart.begin({ low: 0, high: sensor.range_max_m / 1000, top: nice(most * 1.05), unit: "km", yTick: (v) => `${v}`, xTick: (v) => `${+v.toPrecision(3)}` });
    const { context } = this.#chart;
    for (const [range, height, age] of plots) {
      if (height > nice(most * 1.05)) continue;
      context.fillStyle = faded(sensorColour(number), 0.15 + 0.85 * (1 - age));
      context.fillRect(this.#chart.x(range / 1000) - 2, this.#chart.y(height) - 2, 4, 4);
    }
    context.strokeStyle = colours.truth;
    for (const [range, height] of drones) context.strokeRect(this.#chart.x(range / 1000) - 3, this.#chart.y(height) - 3, 6, 6);
    if (!plots.length && !drones.length) this.#chart.say(`${sensor.id}: no heights`);
    byId("heights-text").textContent = `${sensor.id}: ${plots.length} plots with a height${truth ? `, ${drones.length} drones within its range` : ""}`;
  }
}

/** Above nearly all of them; false alarms far up would press the others down. */
function usualMost(heights) {
  const sorted = heights.sort((a, b) => a - b);
  return Math.max(1.3 * (sorted[Math.floor(0.9 * (sorted.length - 1))] ?? 0), 90);
}

function plotHeights({ plots }, number, nowMs, glowMs, siteM) {
  const found = [];
  for (let row = plots.begin; row < plots.end; row++) {
    const at = plots.at(row), age = (nowMs - plots.shown_ms[at]) / glowMs;
    if (plots.sensor[at] !== number || age < 0 || age >= 1 || !Number.isFinite(plots.height_m[at])) continue;
    found.push([plots.range_m[at] * Math.cos(((plots.elevation_deg[at] || 0) * Math.PI) / 180), plots.height_m[at] - siteM, age]);
  }
  return found.filter(([range]) => Number.isFinite(range));
}

function droneHeights(drones, sensor, nowMs) {
  const found = [];
  for (let i = 0; i < drones.rows; i++) {
    const [east, north] = dronePlace(drones, i, nowMs), range = Math.hypot(east - sensor.east_m, north - sensor.north_m);
    if (drones.gone_ms[i] === 0 && range <= sensor.range_max_m) found.push([range, drones.up_m[i]]);
  }
  return found;
}
