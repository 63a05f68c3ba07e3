// What is on the display: plots and bearings that fade, drones, tracks; and, anew for every frame of
// the screen, the sweeps and what is selected.

import { TrackFlag } from "./frames.js";
import { colours, faded, sensorColour, SENSOR_COLOURS } from "./colours.js";

const LEVELS = 10; // of fading
const SWEEP_DEG = 32;
const MOST_SWEEPS = 12; // with an afterglow; of more, lines alone
const MOST_LABELS = 90;
let size = 1; // of marks, larger on large displays
const AHEAD_S = 8; // of a velocity's line

const order = new Uint32Array(1 << 16);
const starts = new Uint32Array(SENSOR_COLOURS * LEVELS + 1);
const cells = new Uint16Array(1 << 16);

/** What moves slowly or fades. */
export function drawMarks(context, view, picture, nowMs, options) {
  const scene = picture.news.scene;
  if (!scene) return;
  size = Math.min(Math.max(Math.min(view.width, view.height) / 640, 1), 1.7);
  const hiddenNumbers = new Set(scene.sensors.flatMap((sensor, number) => (options.hidden.has(sensor.id) ? [number] : [])));
  const labels = new Labels(context);
  if (options.truth && picture.drones) drawDrones(context, view, picture, nowMs, options, labels);
  if (options.truth) drawLost(context, view, picture.lost, nowMs, options, hiddenNumbers);
  drawPlots(context, view, picture.plots, scene, nowMs, options, hiddenNumbers);
  if (options.layers.tracks) drawTracks(context, view, picture, nowMs, options, labels);
}

/** What turns, and what is selected. */
export function drawMoving(context, view, picture, nowMs, options) {
  const scene = picture.news.scene;
  if (scene && options.layers.sweep) drawSweeps(context, view, picture, scene, nowMs, options.hidden);
  if (scene && options.selected) drawSelection(context, view, picture, nowMs, options);
}

/** Azimuth of a beam that passes north at whole multiples of its period, degrees. */
export function beamAzimuth(nowMs, periodS) {
  return ((nowMs / 1000 / periodS) % 1) * 360;
}

function drawSweeps(context, view, picture, scene, nowMs, hidden) {
  const off = (sensor) => hidden.has(sensor.id) || picture.news.settings?.[sensor.id]?.enabled === false;
  const turning = scene.sensors.map((sensor, number) => ({ sensor, number })).filter(({ sensor }) => sensor.rotates && !off(sensor));
  for (const { sensor, number } of turning) {
    const x = view.x(sensor.east_m), y = view.y(sensor.north_m), radius = sensor.range_max_m / view.scale;
    const beam = ((beamAzimuth(nowMs, sensor.period_s) - 90) * Math.PI) / 180, wedge = (SWEEP_DEG * Math.PI) / 180;
    const colour = sensorColour(number);
    if (turning.length <= MOST_SWEEPS && picture.pace <= 2) {
      const glow = context.createConicGradient(beam - wedge, x, y);
      glow.addColorStop(0, faded(colour, 0));
      glow.addColorStop(SWEEP_DEG / 360, faded(colour, 0.2));
      context.fillStyle = glow;
      context.beginPath();
      context.moveTo(x, y);
      context.arc(x, y, radius, beam - wedge, beam);
      context.closePath();
      context.fill();
    }
    context.strokeStyle = faded(colour, 0.75);
    context.lineWidth = 1.2;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + radius * Math.cos(beam), y + radius * Math.sin(beam));
    context.stroke();
  }
}

/** Plots sorted by colour and age, so that each colour is set once. */
function drawPlots(context, view, plots, scene, nowMs, { glowMs, truth }, hiddenNumbers) {
  const count = plots.end - plots.begin;
  starts.fill(0);
  const none = SENSOR_COLOURS * LEVELS;
  for (let i = 0; i < count; i++) {
    const at = plots.at(plots.begin + i), age = (nowMs - plots.shown_ms[at]) / glowMs;
    let cell = none;
    if (age < 1 && !hiddenNumbers.has(plots.sensor[at])) {
      cell = (plots.sensor[at] % SENSOR_COLOURS) * LEVELS + Math.max(0, Math.floor(age * LEVELS));
      starts[cell + 1]++;
    }
    cells[i] = cell;
  }
  for (let cell = 0; cell < none; cell++) starts[cell + 1] += starts[cell];
  const next = starts.slice();
  for (let i = 0; i < count; i++) if (cells[i] !== none) order[next[cells[i]]++] = plots.at(plots.begin + i);
  for (let level = LEVELS - 1; level >= 0; level--) {
    for (let colour = 0; colour < SENSOR_COLOURS; colour++) {
      const cell = colour * LEVELS + level;
      if (starts[cell] < starts[cell + 1]) drawBatch(context, view, plots, scene, starts[cell], starts[cell + 1], sensorColour(colour), level, truth);
    }
  }
}

function drawBatch(context, view, plots, scene, from, to, colour, level, truth) {
  const strength = (1 - level / LEVELS) ** 1.5, side = size * (level === 0 ? 5 : level < 3 ? 4 : 3);
  const alpha = 0.12 + 0.88 * strength;
  context.fillStyle = faded(colour, alpha);
  context.strokeStyle = faded(colour, alpha);
  context.lineWidth = 1.4;
  const { width, height } = view, half = side / 2;
  let crosses = 0, rays = 0;
  context.beginPath();
  for (let i = from; i < to; i++) {
    const at = order[i];
    if (plots.flags[at]) { rays++; continue; }
    const x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    if (x < -9 || y < -9 || x > width + 9 || y > height + 9) continue;
    if (truth && plots.drone[at] === -1) { crosses++; continue; }
    context.rect(x - half, y - half, side, side);
    if (truth && plots.merged[at]) context.strokeRect(x - half - 2.5, y - half - 2.5, side + 5, side + 5);
  }
  context.fill();
  if (crosses) drawCrosses(context, view, plots, from, to);
  if (rays) drawRays(context, view, plots, scene, from, to, colour, strength, truth);
}

/** False alarms, told apart only where the truth is shown. */
function drawCrosses(context, view, plots, from, to) {
  const arm = 3.5 * size;
  context.beginPath();
  for (let i = from; i < to; i++) {
    const at = order[i];
    if (plots.flags[at] || plots.drone[at] !== -1) continue;
    const x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    context.moveTo(x - arm, y - arm);
    context.lineTo(x + arm, y + arm);
    context.moveTo(x + arm, y - arm);
    context.lineTo(x - arm, y + arm);
  }
  context.stroke();
}

/** Bearings as rays to the edge of cover; what has no direction as a ring about its sensor. */
function drawRays(context, view, plots, scene, from, to, colour, strength, truth) {
  context.strokeStyle = faded(colour, 0.06 + 0.6 * strength);
  context.lineWidth = 1.1;
  for (const falsely of truth ? [false, true] : [false]) {
    context.setLineDash(falsely ? [3, 5] : []);
    context.beginPath();
    for (let i = from; i < to; i++) {
      const at = order[i], sensor = scene.sensors[plots.sensor[at]];
      if (!plots.flags[at] || !sensor || (truth && plots.isFalse(at) !== falsely)) continue;
      const x = view.x(sensor.east_m), y = view.y(sensor.north_m);
      if (plots.isNowhere(at)) {
        context.moveTo(x + 13, y);
        context.arc(x, y, 13, 0, 2 * Math.PI);
      } else {
        context.moveTo(x, y);
        context.lineTo(view.x(plots.east_m[at]), view.y(plots.north_m[at]));
      }
    }
    context.stroke();
  }
  context.setLineDash([]);
}

function drawLost(context, view, lost, nowMs, { glowMs }, hiddenNumbers) {
  for (let row = lost.begin; row < lost.end; row++) {
    const at = lost.at(row), age = (nowMs - lost.shown_ms[at]) / glowMs;
    if (age >= 1 || lost.flags[at] || hiddenNumbers.has(lost.sensor[at])) continue;
    context.strokeStyle = faded(sensorColour(lost.sensor[at]), 0.8 * (1 - age) + 0.1);
    context.lineWidth = 1.1;
    context.beginPath();
    context.arc(view.x(lost.east_m[at]), view.y(lost.north_m[at]), 4 * size, 0, 2 * Math.PI);
    context.stroke();
  }
}

/** Where a drone is between two updates. */
export function dronePlace(drones, i, nowMs) {
  const seconds = drones.gone_ms[i] > 0 ? 0 : Math.min(Math.max((nowMs - drones.ms) / 1000, -5), 5);
  return [drones.east_m[i] + seconds * drones.velocity_east_m_s[i], drones.north_m[i] + seconds * drones.velocity_north_m_s[i]];
}

function drawDrones(context, view, { drones, droneNames }, nowMs, { layers }, labels) {
  const seen = [];
  for (let i = 0; i < drones.rows; i++) {
    const [east, north] = dronePlace(drones, i, nowMs), x = view.x(east), y = view.y(north);
    if (x > -20 && y > -20 && x < view.width + 20 && y < view.height + 20) seen.push([i, x, y]);
  }
  const length = size * (seen.length > 300 ? 5 : 7);
  context.strokeStyle = colours.sea;
  context.lineWidth = 1;
  context.fillStyle = colours.truth;
  context.beginPath();
  for (const [i, x, y] of seen) if (drones.gone_ms[i] === 0) traceDrone(context, x, y, drones, i, length);
  context.fill();
  context.stroke();
  context.strokeStyle = colours.warn;
  context.setLineDash([2, 2]);
  context.beginPath();
  for (const [i, x, y] of seen) if (drones.gone_ms[i] > 0) traceDrone(context, x, y, drones, i, length);
  context.stroke();
  context.setLineDash([]);
  if (!layers.labels || seen.length > MOST_LABELS) return;
  for (const [i, x, y] of seen) {
    const gone = drones.gone_ms[i], name = droneNames[drones.drone[i]] ?? "";
    labels.put(gone > 0 ? `${name} gone ${Math.round(gone / 1000)} s` : name, x + 10 * size, y - 8 * size, gone > 0 ? colours.warn : colours.truth);
  }
}

/** Words beside marks; what would lie over others is left out. */
class Labels {
  #taken = [];

  constructor(context) {
    this.context = context;
    context.font = colours.font;
    context.textAlign = "left";
    context.textBaseline = "middle";
  }

  put(words, x, y, colour) {
    const wide = words.length * 6.2 * size;
    if (this.#taken.some(([tx, ty, tw]) => Math.abs(ty - y) < 11 * size && x < tx + tw && tx < x + wide)) return;
    this.#taken.push([x, y, wide]);
    this.context.fillStyle = colour;
    this.context.fillText(words, x, y);
  }
}

/** An arrowhead in the direction of flight; a diamond for one that stands. */
function traceDrone(context, x, y, drones, i, length) {
  const east = drones.velocity_east_m_s[i], north = drones.velocity_north_m_s[i], speed = Math.hypot(east, north);
  const [s, c] = speed > 0.2 ? [east / speed, north / speed] : [0, 1];
  const point = (ahead, right) => [x + ahead * s + right * c, y - ahead * c + right * s];
  const shape = speed > 0.2 ? [[1.25, 0], [-0.85, 0.8], [-0.4, 0], [-0.85, -0.8]] : [[0.9, 0], [0, 0.9], [-0.9, 0], [0, -0.9]];
  shape.forEach(([ahead, right], k) => context[k ? "lineTo" : "moveTo"](...point(ahead * length, right * length)));
  context.closePath();
}

/** Where a track is between two reports. */
export function trackPlace(track, nowMs) {
  const seconds = Math.min(Math.max((nowMs - track.t_utc_ms) / 1000, 0), 3);
  return [track.east_m + seconds * (track.velocity_east_m_s || 0), track.north_m + seconds * (track.velocity_north_m_s || 0)];
}

function drawTracks(context, view, { tracks }, nowMs, { layers }, labels) {
  const labelled = layers.labels && tracks.size <= MOST_LABELS;
  for (const track of tracks.values()) {
    const [east, north] = trackPlace(track, nowMs), x = view.x(east), y = view.y(north);
    const tentative = track.flags & TrackFlag.TENTATIVE, coasted = track.flags & TrackFlag.COASTED;
    context.strokeStyle = faded(colours.track, 0.35);
    context.lineWidth = 1;
    context.beginPath();
    for (let i = 0; i < track.trail.length; i += 2) context[i ? "lineTo" : "moveTo"](view.x(track.trail[i]), view.y(track.trail[i + 1]));
    context.stroke();
    context.strokeStyle = faded(colours.track, tentative ? 0.6 : 1);
    context.lineWidth = 1.4;
    context.setLineDash(coasted ? [2, 2] : []);
    context.strokeRect(x - 6 * size, y - 6 * size, 12 * size, 12 * size);
    context.setLineDash([]);
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(view.x(east + AHEAD_S * (track.velocity_east_m_s || 0)), view.y(north + AHEAD_S * (track.velocity_north_m_s || 0)));
    context.stroke();
    if (labelled) labels.put(`T${track.id}`, x + 10 * size, y + 10 * size, colours.track);
  }
}

function drawSelection(context, view, picture, nowMs, { selected, truth }) {
  const place = placeOf(picture, selected, nowMs);
  if (!place) return;
  const x = view.x(place[0]), y = view.y(place[1]);
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.5;
  if (truth && selected.kind === "plot" && picture.plots.drone[selected.at] >= 0) {
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(view.x(picture.plots.true_east_m[selected.at]), view.y(picture.plots.true_north_m[selected.at]));
    context.stroke();
  }
  context.beginPath();
  context.arc(x, y, 12 * size, 0, 2 * Math.PI);
  context.stroke();
}

/** East and north of what is selected; null if it is no longer there. */
export function placeOf(picture, selected, nowMs) {
  if (selected.kind === "plot") {
    if (!picture.plots.holds(selected.row) || picture.plots.isNowhere(selected.at)) return null;
    return [picture.plots.east_m[selected.at], picture.plots.north_m[selected.at]];
  }
  if (selected.kind === "track") {
    const track = picture.tracks.get(selected.id);
    return track ? trackPlace(track, nowMs) : null;
  }
  const i = picture.drones ? Array.prototype.indexOf.call(picture.drones.drone, selected.drone) : -1;
  return i < 0 ? null : dronePlace(picture.drones, i, nowMs);
}
