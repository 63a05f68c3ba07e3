// What looks: the lenses of mounts and the beams that a radar steers, where they point; and who jams.

import { colours, faded, sensorColour } from "./colours.js";
import { line } from "./common.js";

const JAMMER_HALF = 7;
const radians = (azimuth) => ((azimuth - 90) * Math.PI) / 180;

/** Sensors that are shown and on, each with its number. */
export function watching(scene, hidden) {
  return scene.sensors.map((sensor, number) => ({ sensor, number })).filter(({ sensor }) => sensor.enabled && !hidden.has(sensor.id));
}

/** Where mounts and steered beams point now, as far as each sensor sees. */
export function drawPointing(context, view, { scene, pointing = {} }, hidden) {
  for (const { sensor, number } of watching(scene, hidden)) {
    const at = pointing[sensor.id], colour = sensorColour(number);
    if (!at) continue;
    const wedge = (from, span, alpha) => {
      context.fillStyle = faded(colour, alpha);
      traceSector(context, view, sensor, from, span);
      context.fill();
    };
    if (at.search_deg) {
      for (const azimuth of at.search_deg) wedge(azimuth - at.width_deg / 2, at.width_deg, 0.06);
      for (const azimuth of at.tracks_deg) wedge(azimuth - at.width_deg / 2, at.width_deg, 0.45);
      continue;
    }
    wedge(at.from_deg, at.span_deg, at.sees ? 0.22 : 0.08);
    context.strokeStyle = faded(colour, 0.9);
    context.lineWidth = 1.2;
    context.setLineDash(at.sees ? [] : [3, 4]); // still on its way there
    drawRay(context, view, sensor, at.sees ? at.pan_deg : at.aim_deg);
    context.setLineDash([]);
  }
}

/** Trace what a sensor covers clockwise from an azimuth, between its blind range and its instrumented one. */
export function traceSector(context, view, sensor, fromDeg, spanDeg, nearM = 0) {
  const x = view.x(sensor.east_m), y = view.y(sensor.north_m), from = radians(fromDeg), to = radians(fromDeg + spanDeg);
  const whole = spanDeg >= 360, near = nearM / view.scale;
  context.beginPath();
  context.arc(x, y, sensor.range_max_m / view.scale, from, to);
  if (whole) context.moveTo(x + near, y);
  if (near > 0.5) context.arc(x, y, near, whole ? 2 * Math.PI : to, whole ? 0 : from, true);
  else if (!whole) context.lineTo(x, y);
  context.closePath();
}

/** A straight line from a sensor as far as it sees. */
export function drawRay(context, view, sensor, azimuth) {
  const x = view.x(sensor.east_m), y = view.y(sensor.north_m), far = sensor.range_max_m / view.scale;
  line(context, x, y, x + far * Math.cos(radians(azimuth)), y + far * Math.sin(radians(azimuth)));
}

/** Jammers, each once, with a line to every sensor that hears it. */
export function drawJammers(context, view, scene, hidden, labels) {
  const places = new Map();
  for (const { sensor } of watching(scene, hidden)) for (const { id, east_m: east, north_m: north } of sensor.jammers) {
    const key = `${id} ${east} ${north}`, jammer = places.get(key) ?? { id, x: view.x(east), y: view.y(north), jams: [] };
    jammer.jams.push(sensor);
    places.set(key, jammer);
  }
  for (const { id, x, y, jams } of places.values()) {
    context.strokeStyle = faded(colours.bad, 0.55);
    context.lineWidth = 1;
    context.setLineDash([2, 5]);
    for (const sensor of jams) line(context, x, y, view.x(sensor.east_m), view.y(sensor.north_m));
    context.setLineDash([]);
    drawBolt(context, x, y, JAMMER_HALF);
    labels?.block(x, y, JAMMER_HALF);
    labels?.beside(`jammer ${id}: ${jams.map((sensor) => sensor.id).join(", ")}`, x, y, colours.bad, { far: true, over: true });
  }
}

export function drawBolt(context, x, y, half) {
  context.fillStyle = colours.bad;
  context.beginPath();
  for (const [dx, dy] of [[0.3, -1], [-0.7, 0.2], [-0.05, 0.2], [-0.3, 1], [0.7, -0.2], [0.05, -0.2]]) context.lineTo(x + half * dx, y + half * dy);
  context.closePath();
  context.fill();
}

/** What a mount or a steered beam does, in words; empty for what does not turn. */
export function pointingWords(at) {
  if (!at) return "";
  if (at.search_deg) return `Steered beam: searched ${at.search_deg.length} azimuths in its last period, looked at ${at.tracks_deg.length} tracks.`;
  const by = { "": "no cue", cue: "a cue message", look_at: "its look_at" }[at.cued_by] ?? `plots of ${at.cued_by}`;
  const where = `${at.pan_deg.toFixed(1)}°, ${at.tilt_deg.toFixed(1)}° up, ${+at.span_deg.toPrecision(3)}° wide`;
  return `Points to ${where}; ${at.sees ? "sees" : `turns to ${at.aim_deg.toFixed(1)}°, sees nothing`}; by ${by}.`;
}
