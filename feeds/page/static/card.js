// What is known of the mark that is selected, and what the marks mean.

import { colours } from "./colours.js";
import { byId, clock, drawCross, element, fixed, line } from "./common.js";
import { inKilometres } from "./ground.js";
import { droneNow, trackNow } from "./marks.js";
import { drawBolt } from "./looks.js";
import { arrowOf, shapeOf, swatch, traceVertices } from "./shapes.js";


/** Show what is selected; false if it is no longer there. */
export function showCard(picture, selected, { truth, nowMs }) {
  const found = selected && describe(picture, selected, truth, nowMs);
  byId("card-title").textContent = found ? found.title : "Nothing selected";
  byId("card-hint").hidden = Boolean(found);
  byId("card-values").replaceChildren(...(found?.rows ?? []).flatMap(([name, measured, real = ""]) => {
    const cells = [["dt", name], ["dd", measured], ["dd", real]].map(([tag, words]) => element(tag, words));
    cells[2].className = "true";
    return cells;
  }));
  return Boolean(found);
}

/** Title and rows of what is known of a mark; null of one that is not there, or is hidden. */
export function describe(picture, selected, truth, nowMs) {
  if (selected.kind === "plot") return describePlot(picture, selected, truth);
  if (selected.kind === "track") return describeTrack(picture.tracks.get(selected.id), nowMs);
  return truth ? describeDrone(picture, selected.drone, nowMs) : null;
}

function describePlot({ plots, news, droneNames }, { row, at }, truth) {
  const sensor = news.scene?.sensors[plots.sensor[at]];
  if (!plots.holds(row) || !sensor) return null;
  const tells = truth && plots.drone[at] >= -1, has = tells && plots.drone[at] >= 0;
  const real = (words) => (has ? words : "");
  const error = Math.hypot(plots.east_m[at] - plots.true_east_m[at], plots.north_m[at] - plots.true_north_m[at]);
  const rows = [
    ["", "measured", tells ? "true" : ""],
    ["Range", fixed(plots.range_m[at], 1, " m"), real(fixed(plots.true_range_m[at], 1, " m"))],
    ["Azimuth", fixed(plots.azimuth_deg[at], 3, "°"), real(fixed(plots.true_azimuth_deg[at], 3, "°"))],
    ["Elevation", fixed(plots.elevation_deg[at], 2, "°"), real(fixed(plots.true_elevation_deg[at], 2, "°"))],
    ["Height", fixed(plots.height_m[at], 0, " m")],
    ["SNR", fixed(plots.snr_db[at], 1, " dB")],
    ["Latency", fixed(plots.latency_ms[at], 1, " ms")],
    ["Measured", clock(plots.t_utc_ms[at], 3)],
  ];
  const others = plots.merged[at] ? ` + ${plots.merged[at]}` : "";
  if (tells) rows.push(["Of", has ? (droneNames[plots.drone[at]] ?? "a drone") + others : "false alarm", has && !plots.isBearing(at) ? `off ${fixed(error, 1, " m")}` : ""]);
  return { title: `Plot of ${sensor.id}`, rows };
}

function describeTrack(track, nowMs) {
  if (!track) return null;
  const now = trackNow(track, nowMs);
  return { title: `Track ${track.name}`, rows: [...flightRows(now), ["Updated", fixed(now.age, 1, " s ago")], ["State", now.state]] };
}

function describeDrone(picture, drone, nowMs) {
  const i = picture.drones ? Array.prototype.indexOf.call(picture.drones.drone, drone) : -1;
  if (i < 0) return null;
  const now = droneNow(picture, i, nowMs), kind = picture.droneClasses[drone] ?? "drone";
  return { title: `${kind[0].toUpperCase()}${kind.slice(1)} ${now.name}`, rows: [...flightRows(now), ["Above site", fixed(now.up, 0, " m")], ["State", now.state]] };
}

function flightRows({ azimuth, distance, speed, course }) {
  return [["From site", `${azimuth.toFixed(1)}°`, inKilometres(distance)], ["Speed", fixed(speed, 1, " m/s")], ["Course", fixed(course, 0, "°")]];
}

const MARKS = {
  bearing: (c) => { c.strokeStyle = colours.ink; line(c, 1, 16, 17, 3); },
  track: (c) => { c.strokeStyle = colours.track; c.strokeRect(4.5, 4.5, 9, 9); line(c, 9, 9, 17, 3); },
  "track, coasted": (c) => { c.strokeStyle = colours.track; c.setLineDash([4, 3]); c.strokeRect(4.5, 4.5, 9, 9); line(c, 9, 9, 17, 3); },
  "track, not updated": (c) => { c.strokeStyle = colours.track; c.setLineDash([1, 3]); c.strokeRect(4.5, 4.5, 9, 9); },
  jammer: (c) => drawBolt(c, 9, 9, 7),
  drone: (c) => { c.strokeStyle = colours.truth; arrowhead(c); },
  "drone gone": (c) => { c.strokeStyle = colours.gone; c.setLineDash([2, 2]); arrowhead(c); },
  "false alarm": (c) => { c.strokeStyle = colours.ink; drawCross(c, 9, 9, 4); },
  "lost by the link": (c) => { c.strokeStyle = colours.ink; c.beginPath(); c.arc(9, 9, 4.5, 0, 7); c.stroke(); },
  "several drones": (c) => { c.fillStyle = c.strokeStyle = colours.ink; c.fillRect(7, 7, 4, 4); c.strokeRect(4, 4, 10, 10); },
};
const ALWAYS = ["bearing", "track", "track, coasted", "track, not updated", "jammer"];

function arrowhead(context) {
  context.beginPath();
  traceVertices(context, arrowOf(0, 1), 9, 9, 6.5);
  context.stroke();
}

/** What the marks mean that are shown: the shapes of the scene's kinds of sensors first. */
export function showLegend(truth, scene) {
  const kinds = new Map((scene?.sensors ?? []).map((sensor) => [sensor.type, sensor.label])), head = element("li", "Sensors, and their plots:");
  const shapes = [...kinds].map(([type, label]) => {
    const item = element("li");
    item.append(swatch(shapeOf(type), ""), label);
    return item;
  });
  const names = Object.keys(MARKS).filter((name) => truth || ALWAYS.includes(name)), dpr = devicePixelRatio || 1;
  byId("legend").replaceChildren(...(kinds.size ? [head, ...shapes] : []), ...names.map((name) => {
    const item = element("li"), canvas = element("canvas");
    canvas.width = canvas.height = 18 * dpr;
    canvas.setAttribute("aria-hidden", "true");
    const context = canvas.getContext("2d");
    context.scale(dpr, dpr);
    context.lineWidth = 1.4;
    MARKS[name](context);
    item.append(canvas, name);
    return item;
  }));
}
