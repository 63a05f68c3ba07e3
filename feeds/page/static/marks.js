// What is on the display: plots and bearings that fade, drones, tracks; and, anew for every frame of
// the screen, the sweeps and what is selected.

import { FALSE_ALARM, TrackFlag } from "./frames.js";
import { ageText, droneState, fadedTo, isSilent, stateOf } from "./track_states.js";
import { colours, faded, sensorColour, SENSOR_COLOURS } from "./colours.js";
import { drawCross, line } from "./common.js";
import { Labels } from "./labels.js";
import { drawPointing, drawRay, traceSector, watching } from "./looks.js";
import { packed } from "./pixels.js";
import { arrowOf, arrowStamp, shapeOf, stampOf, traceShape, traceVertices } from "./shapes.js";
import { azimuthOf } from "./viewport.js";

const LEVELS = 10; // of fading
const SWEEP_DEG = 32;
const MOST_SWEEPS = 12; // with an afterglow; of more, lines alone
const MOST_LABELS = 90;
const MANY_DRONES = 300;
const STAMPED_DRONE = 5; // half its length, in pixels
let size = 1; // of marks, larger on large displays
const AHEAD_S = 8; // of a velocity's line

const WIDTHS = Array.from({ length: LEVELS }, (_, level) => (level < 1 ? 9 : level < 4 ? 7 : 5));
const OPACITIES = Array.from({ length: LEVELS }, (_, level) => 0.12 + 0.88 * (1 - level / LEVELS) ** 1.5);
const BATCH = 40; // shapes in one path: much longer ones are slow
const others = []; // plots that are more than a small mark, each with its level

/** What moves slowly or fades, over the ground that `pixels` knows; the places of all words. */
export function drawMarks(context, pixels, view, picture, nowMs, options) {
  const scene = picture.news.scene;
  if (!scene) {
    pixels.begin();
    pixels.put(context);
    return [];
  }
  size = Math.min(Math.max(Math.min(view.width, view.height) / 640, 1), 1.7);
  const hiddenNumbers = new Set(scene.sensors.flatMap((sensor, number) => (options.hidden.has(sensor.id) ? [number] : [])));
  const labels = new Labels(context, view, options.placed);
  const drones = options.truth && picture.drones ? dronesSeen(view, picture.drones, nowMs) : [];
  pixels.begin();
  drawPlots(pixels, context, view, picture.plots, nowMs, options, hiddenNumbers, scene);
  if (drones.length > MANY_DRONES) stampDrones(pixels, context, picture.drones, drones);
  pixels.put(context);
  drawOthers(context, view, picture.plots, scene, options);
  if (options.truth) drawLost(context, view, picture.lost, nowMs, options, hiddenNumbers);
  if (drones.length <= MANY_DRONES) drawDrones(context, picture, drones, options, labels);
  if (options.layers.tracks) drawTracks(context, view, picture, nowMs, options, labels);
  labels.writeAgain();
  return labels.placed;
}

/** What turns, and what is selected. */
export function drawMoving(context, view, picture, nowMs, options) {
  const scene = picture.news.scene;
  if (scene && options.layers.cover) drawPointing(context, view, picture.news, options.hidden);
  if (scene && options.layers.sweep) drawSweeps(context, view, picture, scene, nowMs, options.hidden);
  if (scene && options.selected) drawSelection(context, view, picture, nowMs, options);
}

/** Azimuth of a beam that passes north at whole multiples of its period, degrees. */
export function beamAzimuth(nowMs, periodS) {
  return ((nowMs / 1000 / periodS) % 1) * 360;
}

function drawSweeps(context, view, picture, scene, nowMs, hidden) {
  const turning = watching(scene, hidden).filter(({ sensor }) => sensor.rotates);
  for (const { sensor, number } of turning) {
    const azimuth = beamAzimuth(nowMs, sensor.period_s), from = azimuth - SWEEP_DEG, colour = sensorColour(number);
    if (turning.length <= MOST_SWEEPS && picture.pace <= 2) {
      const glow = context.createConicGradient(((from - 90) * Math.PI) / 180, view.x(sensor.east_m), view.y(sensor.north_m));
      glow.addColorStop(0, faded(colour, 0));
      glow.addColorStop(SWEEP_DEG / 360, faded(colour, 0.2));
      context.fillStyle = glow;
      traceSector(context, view, sensor, from, SWEEP_DEG);
      context.fill();
    }
    context.strokeStyle = faded(colour, 0.75);
    context.lineWidth = 1.2;
    drawRay(context, view, sensor, azimuth);
  }
}

/** Small marks of all plots that have a place, each in the shape of its kind of sensor; what else there is of plots comes later. */
function drawPlots(pixels, context, view, plots, nowMs, { glowMs, truth }, hiddenNumbers, scene) {
  const dpr = context.getTransform().a, packedColours = colours.sensors.map(packed);
  const odd = (wide) => 2 * Math.round((wide * size * dpr - 1) / 2) + 1;
  const stamps = scene.sensors.map((sensor) => WIDTHS.map((wide) => stampOf(shapeOf(sensor.type), odd(wide))));
  others.length = 0;
  for (let row = plots.begin; row < plots.end; row++) {
    const at = plots.at(row), age = (nowMs - plots.shown_ms[at]) / glowMs, sensor = plots.sensor[at];
    if (age >= 1 || hiddenNumbers.has(sensor)) continue;
    const level = Math.max(0, Math.floor(age * LEVELS));
    if (plots.flags[at] || (truth && (plots.drone[at] === FALSE_ALARM || plots.merged[at]))) others.push(at, level);
    if (plots.flags[at] || (truth && plots.drone[at] === FALSE_ALARM)) continue;
    const x = view.x(plots.east_m[at]), y = view.y(plots.north_m[at]);
    pixels.stamp(x * dpr, y * dpr, stamps[sensor][level], packedColours[sensor % SENSOR_COLOURS], Math.round(OPACITIES[level] * 256));
  }
}

/** Bearings, and what the truth tells of plots: false alarms as crosses, a frame about several drones in one. */
function drawOthers(context, view, plots, scene, { truth }) {
  context.lineWidth = 1.3;
  for (let i = 0; i < others.length; i += 2) {
    const at = others[i], colour = sensorColour(plots.sensor[at]), opacity = OPACITIES[others[i + 1]];
    context.strokeStyle = faded(colour, plots.flags[at] ? 0.75 * opacity : opacity);
    if (plots.flags[at]) drawBearing(context, view, plots, scene.sensors[plots.sensor[at]], at, truth);
    else if (plots.drone[at] === FALSE_ALARM) drawCross(context, view.x(plots.east_m[at]), view.y(plots.north_m[at]), 3.5 * size);
    else context.strokeRect(view.x(plots.east_m[at]) - 5 * size, view.y(plots.north_m[at]) - 5 * size, 10 * size, 10 * size);
  }
}

/** A bearing as a ray to the edge of cover, where its kind's shape is; what has no direction as a ring about its sensor. */
function drawBearing(context, view, plots, sensor, at, truth) {
  const x = view.x(sensor.east_m), y = view.y(sensor.north_m);
  context.setLineDash(truth && plots.isFalse(at) ? [3, 5] : []);
  context.beginPath();
  if (plots.isNowhere(at)) {
    context.arc(x, y, 13 * size, 0, 2 * Math.PI);
  } else {
    context.moveTo(x, y);
    context.lineTo(view.x(plots.east_m[at]), view.y(plots.north_m[at]));
  }
  context.stroke();
  context.setLineDash([]);
  if (plots.isNowhere(at)) return;
  context.fillStyle = context.strokeStyle;
  traceShape(context, shapeOf(sensor.type), view.x(plots.east_m[at]), view.y(plots.north_m[at]), 4 * size);
  context.fill();
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

/** Numbers of the drones within the window, each with its place there. */
function dronesSeen(view, drones, nowMs) {
  const seen = [];
  for (let i = 0; i < drones.rows; i++) {
    const [east, north] = dronePlace(drones, i, nowMs), x = view.x(east), y = view.y(north);
    if (x > -20 && y > -20 && x < view.width + 20 && y < view.height + 20) seen.push([i, x, y]);
  }
  return seen;
}

/** Very many drones: as pixels, which are drawn in a fraction of the time. */
function stampDrones(pixels, context, drones, seen) {
  const dpr = context.getTransform().a, truth = packed(colours.truth), warn = packed(colours.gone);
  for (const [i, x, y] of seen) {
    const stamp = arrowStamp(drones.velocity_east_m_s[i], drones.velocity_north_m_s[i], STAMPED_DRONE * size * dpr);
    pixels.stamp(x * dpr, y * dpr, stamp, drones.gone_ms[i] > 0 ? warn : truth, 220);
  }
}

function drawDrones(context, { drones, droneNames, droneClasses }, seen, { layers }, labels) {
  const length = 7 * size;
  context.lineWidth = 1.3;
  context.strokeStyle = colours.truth;
  context.fillStyle = faded(colours.truth, 0.3);
  const trace = ([i, x, y]) => traceVertices(context, arrowOf(drones.velocity_east_m_s[i], drones.velocity_north_m_s[i]), x, y, length);
  drawBatches(context, seen.filter(([i]) => drones.gone_ms[i] === 0), trace, true);
  context.strokeStyle = colours.gone;
  context.setLineDash([2, 2]);
  drawBatches(context, seen.filter(([i]) => drones.gone_ms[i] > 0), trace, false);
  context.setLineDash([]);
  if (!layers.labels || seen.length > MOST_LABELS) return;
  for (const [, x, y] of seen) labels.block(x, y, 0.8 * length);
  for (const [i, x, y] of seen) {
    const gone = drones.gone_ms[i], number = drones.drone[i], what = droneClasses[number];
    const name = (droneNames[number] ?? "") + (what ? ` (${what})` : "");
    labels.beside(gone > 0 ? `${name} gone ${Math.round(gone / 1000)} s` : name, x, y, colours.ink, { size });
  }
}

/** Shapes of one colour, some in a path. */
function drawBatches(context, shapes, trace, filled) {
  for (let from = 0; from < shapes.length; from += BATCH) {
    context.beginPath();
    shapes.slice(from, from + BATCH).forEach(trace);
    if (filled) context.fill();
    context.stroke();
  }
}

/** Where a track is between two reports; where it was told last, if the next one stays out. */
export function trackPlace(track, nowMs) {
  const seconds = isSilent(track, nowMs) ? 0 : Math.max((nowMs - track.t_utc_ms) / 1000, 0);
  return [track.east_m + seconds * (track.velocity_east_m_s || 0), track.north_m + seconds * (track.velocity_north_m_s || 0)];
}

function drawTracks(context, view, { tracks }, nowMs, { layers }, labels) {
  const labelled = layers.labels && tracks.size <= MOST_LABELS;
  for (const track of tracks.values()) {
    const [east, north] = trackPlace(track, nowMs), x = view.x(east), y = view.y(north);
    const tentative = track.flags & TrackFlag.TENTATIVE, silent = isSilent(track, nowMs), left = silent ? fadedTo(track, nowMs) : 1;
    context.strokeStyle = faded(colours.track, 0.35 * left);
    context.lineWidth = 1;
    context.beginPath();
    for (let i = 0; i < track.trail.length; i += 2) context[i ? "lineTo" : "moveTo"](view.x(track.trail[i]), view.y(track.trail[i + 1]));
    context.stroke();
    context.strokeStyle = faded(colours.track, (tentative ? 0.6 : 1) * left);
    context.lineWidth = 1.4;
    context.setLineDash(silent ? [1, 4] : track.flags & TrackFlag.COASTED ? [4, 3] : []);
    context.strokeRect(x - 6 * size, y - 6 * size, 12 * size, 12 * size);
    context.setLineDash([]);
    if (!silent) line(context, x, y, view.x(east + AHEAD_S * (track.velocity_east_m_s || 0)), view.y(north + AHEAD_S * (track.velocity_north_m_s || 0)));
    if (labelled) labels.beside(`${track.name === String(track.id) ? "T" : ""}${track.name.slice(0, 20)}${silent ? ` ${ageText(track, nowMs)}` : ""}`, x, y, silent ? colours.quiet : colours.ink, { size });
  }
}

function drawSelection(context, view, picture, nowMs, { selected, truth }) {
  const place = placeOf(picture, selected, nowMs);
  if (!place) return;
  const x = view.x(place[0]), y = view.y(place[1]);
  context.strokeStyle = colours.ink;
  context.lineWidth = 1.5;
  if (truth && selected.kind === "plot" && picture.plots.drone[selected.at] >= 0) {
    line(context, x, y, view.x(picture.plots.true_east_m[selected.at]), view.y(picture.plots.true_north_m[selected.at]));
  }
  context.beginPath();
  context.arc(x, y, 12 * size, 0, 2 * Math.PI);
  context.stroke();
}

/** Where something is and how it flies, as cards and tables tell it: from the site, and over ground. */
export function flightOf([east, north], velocityEast, velocityNorth) {
  return { azimuth: azimuthOf(east, north), distance: Math.hypot(east, north), speed: Math.hypot(velocityEast, velocityNorth), course: azimuthOf(velocityEast, velocityNorth) };
}

/** A track now, with its age in seconds and its state in words. */
export function trackNow(track, nowMs) {
  return { ...flightOf(trackPlace(track, nowMs), track.velocity_east_m_s, track.velocity_north_m_s), age: (nowMs - track.t_utc_ms) / 1000, state: stateOf(track, nowMs) };
}

/** The drone in a row of a picture's now, with its number, name and state in words. */
export function droneNow({ drones, droneNames, unseen }, i, nowMs) {
  const number = drones.drone[i], name = droneNames[number] ?? String(number);
  return { ...flightOf(dronePlace(drones, i, nowMs), drones.velocity_east_m_s[i], drones.velocity_north_m_s[i]), number, name, up: drones.up_m[i], state: droneState(unseen, name, drones.gone_ms[i]) };
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
