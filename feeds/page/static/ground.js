// What lies still under the marks: map, range rings, azimuth spokes, cover, sites. Drawn anew only when the view moves.

import { colours, faded, sensorColour } from "./colours.js";
import { line } from "./common.js";
import { Labels } from "./labels.js";
import { drawJammers, traceSector } from "./looks.js";
import { shapeOf, traceShape } from "./shapes.js";

const SITE_HALF = 7;
const COVER_LIMIT = 24; // sensors whose cover is filled; of more, lines alone

/** A round number of metres near what is wanted. */
export function nice(wanted) {
  const decade = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].map((step) => step * decade).find((step) => step >= wanted * 0.999);
}

export function inKilometres(metres) {
  if (metres < 1e-9) return "0";
  return metres >= 1000 ? `${+(metres / 1000).toPrecision(3)} km` : `${+metres.toPrecision(3)} m`;
}

/** Between two range rings, metres. */
export function ringSpacing(view) {
  return nice((Math.min(view.width, view.height) * view.scale) / 14);
}

/** Draw it all; the places of its words and sites, which no other words may cover, nor what lies over the picture. */
export function drawGround(context, view, { scene, hidden, layers, basemap, grid, covered }) {
  context.clearRect(0, 0, view.width, view.height);
  context.fillStyle = colours.sea;
  context.fillRect(0, 0, view.width, view.height);
  if (layers.basemap && basemap) drawBasemap(context, view, basemap);
  if (layers.cover && scene) drawCover(context, view, scene, hidden);
  const labels = new Labels(context, view, covered);
  if (grid === "rings") {
    drawRings(context, view, labels);
    drawSpokes(context, view, labels);
  } else if (grid === "squares") drawSquares(context, view, labels);
  if (scene) drawSites(context, view, scene, hidden, layers.labels && labels);
  if (layers.cover && scene) drawJammers(context, view, scene, hidden, layers.labels && labels);
  if (layers.basemap && basemap?.shapes) drawNames(context, view, basemap.shapes.points, labels);
  return labels.placed;
}

function drawBasemap(context, view, { image, corners, shapes }) {
  context.save();
  if (image) {
    const [[e0, n0], [e1, n1], [e2, n2]] = corners;
    const x = view.x(e0), y = view.y(n0), w = image.width, h = image.height;
    const dpr = context.getTransform().a;
    context.setTransform(
      (dpr * (view.x(e1) - x)) / w, (dpr * (view.y(n1) - y)) / w, (dpr * (view.x(e2) - x)) / h, (dpr * (view.y(n2) - y)) / h, dpr * x, dpr * y);
    context.globalAlpha = 0.75;
    context.drawImage(image, 0, 0);
  } else if (shapes) {
    drawShapes(context, view, shapes);
  }
  context.restore();
}

function drawShapes(context, view, { areas, lines }) {
  const trace = (flat) => {
    for (let i = 0; i < flat.length; i += 2) context[i ? "lineTo" : "moveTo"](view.x(flat[i]), view.y(flat[i + 1]));
  };
  context.fillStyle = colours.map;
  context.strokeStyle = colours["map-line"];
  context.lineWidth = 1;
  for (const area of areas) {
    context.beginPath();
    trace(area);
    context.closePath();
    context.fill("evenodd");
    context.stroke();
  }
  context.beginPath();
  for (const line of lines) trace(line);
  context.stroke();
}

function drawNames(context, view, points, labels) {
  for (const [east, north, name] of points) {
    context.fillStyle = colours.quiet;
    context.fillRect(view.x(east) - 2, view.y(north) - 2, 4, 4);
    if (name) labels.beside(name, view.x(east), view.y(north), colours.quiet);
  }
}

/** Filled is what is looked at all the time; a dashed line is about what is off, or what a mount may turn to. */
function drawCover(context, view, scene, hidden) {
  scene.sensors.forEach((sensor, number) => {
    if (hidden.has(sensor.id)) return;
    const colour = sensorColour(number), looks = sensor.enabled && !sensor.turns;
    traceSector(context, view, sensor, sensor.azimuth_min_deg, sensor.turns ? 360 : sensor.azimuth_span_deg, sensor.range_min_m);
    context.setLineDash(looks ? [] : [2, 6]);
    if (looks && scene.sensors.length <= COVER_LIMIT) {
      context.fillStyle = faded(colour, 0.045);
      context.fill("evenodd");
    }
    context.strokeStyle = faded(colour, scene.sensors.length <= COVER_LIMIT ? 0.5 : 0.25);
    context.lineWidth = 1;
    context.stroke();
  });
  context.setLineDash([]);
}

function gridLine(context, x0, y0, x1, y1, isMain) {
  context.strokeStyle = isMain ? colours["grid-strong"] : colours.grid;
  context.lineWidth = 1;
  line(context, x0, y0, x1, y1);
}

/** Lines of equal east and north of the site, as far apart as rings are. */
function drawSquares(context, view, labels) {
  const spacing = ringSpacing(view), inset = 14;
  const along = Math.min(Math.max(view.y(0) + inset, inset), view.height - inset), beside = Math.min(Math.max(view.x(0) + 2 * inset, 2 * inset), view.width - 3 * inset);
  const first = (value) => Math.ceil(value / spacing) * spacing;
  for (let east = first(view.eastAt(0)); view.x(east) < view.width; east += spacing) {
    gridLine(context, view.x(east), 0, view.x(east), view.height, Math.abs(east) < spacing / 2);
    labels.at(`${inKilometres(Math.abs(east))}${east > 0 ? " E" : east < 0 ? " W" : ""}`, view.x(east), along, colours.quiet);
  }
  for (let north = first(view.northAt(view.height)); view.y(north) > 0; north += spacing) {
    gridLine(context, 0, view.y(north), view.width, view.y(north), Math.abs(north) < spacing / 2);
    labels.at(`${inKilometres(Math.abs(north))}${north > 0 ? " N" : north < 0 ? " S" : ""}`, beside, view.y(north), colours.quiet);
  }
}

function drawRings(context, view, labels) {
  const spacing = ringSpacing(view), x = view.x(0), y = view.y(0);
  const corners = [[0, 0], [view.width, 0], [0, view.height], [view.width, view.height]];
  const furthest = Math.max(...corners.map(([cx, cy]) => Math.hypot(cx - x, cy - y))) * view.scale;
  const inside = x >= 0 && x <= view.width && y >= 0 && y <= view.height;
  const nearest = inside ? 0 : Math.hypot(Math.max(-x, x - view.width, 0), Math.max(-y, y - view.height, 0)) * view.scale;
  const first = Math.max(1, Math.floor(nearest / spacing)), last = Math.min(Math.ceil(furthest / spacing), first + 60);
  for (let ring = first; ring <= last; ring++) {
    const radius = (ring * spacing) / view.scale;
    context.strokeStyle = ring % 5 === 0 ? colours["grid-strong"] : colours.grid;
    context.lineWidth = 1;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.stroke();
  }
  for (let ring = first; ring <= last; ring++) {
    const radius = (ring * spacing) / view.scale, angle = (105 * Math.PI) / 180; // between two spokes
    labels.at(inKilometres(ring * spacing), x + radius * Math.sin(angle), y - radius * Math.cos(angle), colours.quiet);
  }
}

function drawSpokes(context, view, labels) {
  const x = view.x(0), y = view.y(0), inset = 15;
  const inside = x > inset && x < view.width - inset && y > inset && y < view.height - inset;
  const long = view.width + view.height + Math.hypot(x, y), hub = 12;
  for (let azimuth = 0; azimuth < 360; azimuth += 30) {
    const [s, c] = [Math.sin((azimuth * Math.PI) / 180), Math.cos((azimuth * Math.PI) / 180)];
    gridLine(context, x + hub * s, y - hub * c, x + long * s, y - long * c, azimuth % 90 === 0);
    if (inside) {
      const out = Math.min(
        s > 1e-9 ? (view.width - inset - 6 - x) / s : s < -1e-9 ? (inset + 6 - x) / s : Infinity,
        c > 1e-9 ? (y - inset) / c : c < -1e-9 ? (y - view.height + inset) / c : Infinity);
      labels.at(azimuth ? `${String(azimuth).padStart(3, "0")}°` : "N", x + out * s, y - out * c, azimuth ? colours.quiet : colours.ink);
    }
  }
}

function drawSites(context, view, scene, hidden, labels) {
  const shown = scene.sensors.map((sensor, number) => ({ sensor, number, x: view.x(sensor.east_m), y: view.y(sensor.north_m) })).filter(({ sensor }) => !hidden.has(sensor.id));
  const masts = new Map(shown.flatMap(({ sensor }) => sensor.transmitters).map((mast) => [`${mast.id} ${mast.east_m} ${mast.north_m}`, { ...mast, x: view.x(mast.east_m), y: view.y(mast.north_m) }]));
  for (const { x, y } of masts.values()) drawMast(context, x, y);
  context.strokeStyle = colours.sea;
  context.lineWidth = 1.5;
  for (const { sensor, number, x, y } of shown) {
    context.fillStyle = sensorColour(number);
    traceShape(context, shapeOf(sensor.type), x, y, SITE_HALF);
    context.fill();
    context.stroke();
  }
  if (!labels) return;
  for (const { x, y } of [...shown, ...masts.values()]) if (within(view, x, y)) labels.block(x, y, SITE_HALF + 1);
  for (const { sensor, x, y } of shown) if (within(view, x, y)) labels.beside(sensor.id, x, y, colours.ink, { far: true, over: true });
  for (const { id, x, y } of masts.values()) if (within(view, x, y)) labels.beside(id, x, y, colours.quiet, { far: true });
}

function within(view, x, y) {
  return x >= 0 && y >= 0 && x <= view.width && y <= view.height;
}

function drawMast(context, x, y) {
  context.strokeStyle = colours.quiet;
  context.lineWidth = 1.2;
  context.beginPath();
  context.moveTo(x, y + 6);
  context.lineTo(x, y - 4);
  context.arc(x, y - 4, 3, 0, 2 * Math.PI);
  context.stroke();
}
