// What lies still under the marks: map, range rings, azimuth spokes, cover, sites. Drawn anew only when the view moves.

import { colours, faded, sensorColour } from "./colours.js";

const COVER_LIMIT = 24; // sensors whose cover is filled; of more, lines alone

/** A round number of metres near what is wanted. */
export function nice(wanted) {
  const decade = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].map((step) => step * decade).find((step) => step >= wanted * 0.999);
}

export function inKilometres(metres) {
  return metres >= 1000 ? `${+(metres / 1000).toPrecision(3)} km` : `${+metres.toPrecision(3)} m`;
}

/** Between two range rings, metres. */
export function ringSpacing(view) {
  return nice((Math.min(view.width, view.height) * view.scale) / 14);
}

export function drawGround(context, view, { scene, hidden, layers, basemap }) {
  context.clearRect(0, 0, view.width, view.height);
  context.fillStyle = colours.sea;
  context.fillRect(0, 0, view.width, view.height);
  if (layers.basemap && basemap) drawBasemap(context, view, basemap);
  if (layers.cover && scene) drawCover(context, view, scene, hidden);
  drawRings(context, view);
  drawSpokes(context, view);
  if (scene) drawSites(context, view, scene, hidden, layers.labels);
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

function drawShapes(context, view, { areas, lines, points }) {
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
  context.font = colours.font;
  context.fillStyle = colours.quiet;
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const [east, north, name] of points) {
    context.fillRect(view.x(east) - 2, view.y(north) - 2, 4, 4);
    context.fillText(name, view.x(east) + 6, view.y(north));
  }
}

function drawCover(context, view, scene, hidden) {
  scene.sensors.forEach((sensor, number) => {
    if (hidden.has(sensor.id)) return;
    const colour = sensorColour(number);
    traceCover(context, view, sensor);
    if (scene.sensors.length <= COVER_LIMIT) {
      context.fillStyle = faded(colour, 0.045);
      context.fill("evenodd");
    }
    context.strokeStyle = faded(colour, scene.sensors.length <= COVER_LIMIT ? 0.5 : 0.25);
    context.lineWidth = 1;
    context.stroke();
  });
}

/** The sector between blind and instrumented range. */
function traceCover(context, view, sensor) {
  const x = view.x(sensor.east_m), y = view.y(sensor.north_m);
  const from = ((sensor.azimuth_min_deg - 90) * Math.PI) / 180, to = from + (sensor.azimuth_span_deg * Math.PI) / 180;
  const whole = sensor.azimuth_span_deg >= 360, near = sensor.range_min_m / view.scale;
  context.beginPath();
  context.arc(x, y, sensor.range_max_m / view.scale, from, to);
  if (whole) context.moveTo(x + near, y);
  if (near > 0.5) context.arc(x, y, near, whole ? 2 * Math.PI : to, whole ? 0 : from, true);
  else if (!whole) context.lineTo(x, y);
  context.closePath();
}

function drawRings(context, view) {
  const spacing = ringSpacing(view), x = view.x(0), y = view.y(0);
  const corners = [[0, 0], [view.width, 0], [0, view.height], [view.width, view.height]];
  const furthest = Math.max(...corners.map(([cx, cy]) => Math.hypot(cx - x, cy - y))) * view.scale;
  const inside = x >= 0 && x <= view.width && y >= 0 && y <= view.height;
  const nearest = inside ? 0 : Math.hypot(Math.max(-x, x - view.width, 0), Math.max(-y, y - view.height, 0)) * view.scale;
  context.font = colours.font;
  context.textAlign = "center";
  context.textBaseline = "middle";
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
    label(context, inKilometres(ring * spacing), x + radius * Math.sin(angle), y - radius * Math.cos(angle), colours.quiet);
  }
}

function drawSpokes(context, view) {
  const x = view.x(0), y = view.y(0), inset = 15;
  const inside = x > inset && x < view.width - inset && y > inset && y < view.height - inset;
  const long = view.width + view.height + Math.hypot(x, y), hub = 12;
  context.font = colours.font;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let azimuth = 0; azimuth < 360; azimuth += 10) {
    const [s, c] = [Math.sin((azimuth * Math.PI) / 180), Math.cos((azimuth * Math.PI) / 180)];
    if (azimuth % 30 === 0) {
      context.strokeStyle = azimuth % 90 === 0 ? colours["grid-strong"] : colours.grid;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(x + hub * s, y - hub * c);
      context.lineTo(x + long * s, y - long * c);
      context.stroke();
    }
    if (inside && azimuth % 30 === 0) {
      const out = Math.min(
        s > 1e-9 ? (view.width - inset - 6 - x) / s : s < -1e-9 ? (inset + 6 - x) / s : Infinity,
        c > 1e-9 ? (y - inset) / c : c < -1e-9 ? (y - view.height + inset) / c : Infinity);
      label(context, azimuth ? `${String(azimuth).padStart(3, "0")}°` : "N", x + out * s, y - out * c, azimuth ? colours.quiet : colours.ink);
    }
  }
}

function drawSites(context, view, scene, hidden, labels) {
  context.font = colours.font;
  context.textAlign = "left";
  context.textBaseline = "middle";
  const taken = [];
  scene.sensors.forEach((sensor, number) => {
    if (hidden.has(sensor.id)) return;
    const x = view.x(sensor.east_m), y = view.y(sensor.north_m);
    for (const transmitter of sensor.transmitters) drawMast(context, view.x(transmitter.east_m), view.y(transmitter.north_m), transmitter.id, labels);
    context.fillStyle = sensorColour(number);
    context.strokeStyle = colours.sea;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x, y - 7);
    context.lineTo(x + 6, y + 4);
    context.lineTo(x - 6, y + 4);
    context.closePath();
    context.fill();
    context.stroke();
    if (!labels) return;
    let line = 0; // sensors that stand together are named below each other
    while (taken.some(([tx, ty]) => Math.abs(tx - x) < 60 && Math.abs(ty - (y + 14 + 13 * line)) < 12)) line++;
    taken.push([x, y + 14 + 13 * line]);
    if (line < 8) label(context, sensor.id, x + 9, y + 14 + 13 * line, sensorColour(number), "left");
  });
}

function drawMast(context, x, y, name, labels) {
  context.strokeStyle = colours.quiet;
  context.lineWidth = 1.2;
  context.beginPath();
  context.moveTo(x, y + 6);
  context.lineTo(x, y - 4);
  context.arc(x, y - 4, 3, 0, 2 * Math.PI);
  context.stroke();
  if (labels) label(context, name, x + 7, y, colours.quiet, "left");
}

/** Text with a halo, so that lines do not cut it. */
function label(context, words, x, y, colour, align = "center") {
  context.textAlign = align;
  context.lineWidth = 4;
  context.lineJoin = "round";
  context.strokeStyle = colours.sea;
  context.strokeText(words, x, y);
  context.fillStyle = colour;
  context.fillText(words, x, y);
}
