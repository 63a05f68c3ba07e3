// A shape for each kind of sensor, so that kinds are told apart without their colours. Vertices are
// in half widths of the mark, x to the right and y down.

const TURN = 2 * Math.PI;
const round = (n, turn = 0, radius = () => 1) => Array.from({ length: n }, (_, i) => [radius(i) * Math.sin((TURN * i) / n + turn), -radius(i) * Math.cos((TURN * i) / n + turn)]);

const SHAPES = {
  square: [[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]],
  diamond: [[0, -1.15], [1.15, 0], [0, 1.15], [-1.15, 0]],
  "triangle up": [[0, -1.1], [1.1, 0.9], [-1.1, 0.9]],
  "triangle down": [[0, 1.1], [1.1, -0.9], [-1.1, -0.9]],
  disc: round(20),
  cross: [[-0.4, -1.1], [0.4, -1.1], [0.4, -0.4], [1.1, -0.4], [1.1, 0.4], [0.4, 0.4], [0.4, 1.1], [-0.4, 1.1], [-0.4, 0.4], [-1.1, 0.4], [-1.1, -0.4], [-0.4, -0.4]],
  star: round(10, 0, (i) => (i % 2 ? 0.5 : 1.25)),
  bar: [[-1.3, -0.5], [1.3, -0.5], [1.3, 0.5], [-1.3, 0.5]],
  hourglass: [[-1, -1.1], [1, -1.1], [0.25, 0], [1, 1.1], [-1, 1.1], [-0.25, 0]],
  pillar: [[-0.5, -1.3], [0.5, -1.3], [0.5, 1.3], [-0.5, 1.3]],
  hexagon: round(6, TURN / 12, () => 1.05),
};
const OF_KINDS = {
  active_radar: "square", mimo_radar: "diamond", passive_radar: "triangle up", multistatic_passive: "triangle down", multistatic_mimo: "hourglass",
  acoustic: "disc", acoustic_pair: "cross", rf: "star", camera: "bar", range_gate: "pillar",
};
const OF_OTHERS = "hexagon";

/** The name of the shape of a kind of sensor, as a scene's `type` names it. */
export function shapeOf(kind) {
  return OF_KINDS[kind] ?? OF_OTHERS;
}

/** Trace it about a place, as a path of its own; `half` is half its width. */
export function traceShape(context, shape, x, y, half) {
  context.beginPath();
  traceVertices(context, SHAPES[shape], x, y, half);
}

/** Trace a closed line about a place, as a part of the path. */
export function traceVertices(context, vertices, x, y, half) {
  vertices.forEach(([dx, dy], k) => context[k ? "lineTo" : "moveTo"](x + half * dx, y + half * dy));
  context.closePath();
}

/** The shape as an element of SVG, with its colour by the style sheet. */
export function swatch(shape, number) {
  const space = "http://www.w3.org/2000/svg", svg = document.createElementNS(space, "svg"), polygon = document.createElementNS(space, "polygon");
  svg.setAttribute("viewBox", "-1.4 -1.4 2.8 2.8");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("class", "swatch");
  svg.dataset.colour = number;
  polygon.setAttribute("points", SHAPES[shape].map((place) => place.join(",")).join(" "));
  svg.append(polygon);
  return svg;
}

const stamps = new Map();

/** Its pixels at an odd width: [dy, from dx, to dx] of each run, one after the other. */
export function stampOf(shape, width) {
  const key = `${shape} ${width}`;
  if (!stamps.has(key)) stamps.set(key, drawStamp(SHAPES[shape], width));
  return stamps.get(key);
}

const HEADINGS = 48;
const ARROW = [[0, -1.25], [0.8, 0.85], [0, 0.4], [-0.8, 0.85]];
const STANDING = 0.2; // metres a second, below which there is no heading

/** Vertices of an arrowhead in the direction of flight; of a diamond for one that stands. */
export function arrowOf(east, north) {
  const speed = Math.hypot(east, north), [s, c] = [east / speed, north / speed];
  return speed < STANDING ? SHAPES.diamond : ARROW.map(([x, y]) => [c * x - s * y, s * x + c * y]);
}

/** The pixels of such an arrowhead of half that length, to some degrees. */
export function arrowStamp(east, north, half) {
  const stands = Math.hypot(east, north) < STANDING, turn = TURN / HEADINGS;
  const heading = stands ? 0 : Math.round(Math.atan2(east, north) / turn), key = `${stands ? "standing" : heading} arrow ${half}`;
  if (!stamps.has(key)) stamps.set(key, drawStamp(stands ? SHAPES.diamond : arrowOf(Math.sin(heading * turn), Math.cos(heading * turn)), 2 * half));
  return stamps.get(key);
}

function drawStamp(vertices, width) {
  const half = width / 2, reach = Math.ceil(1.3 * half), runs = [];
  for (let dy = -reach; dy <= reach; dy++) {
    let from = null;
    for (let dx = -reach; dx <= reach + 1; dx++) {
      const within = (dx === 0 && dy === 0) || isWithin(vertices, dx / half, dy / half);
      if (within && from === null) from = dx;
      if (!within && from !== null) { runs.push(dy, from, dx); from = null; }
    }
  }
  return Int8Array.from(runs);
}

function isWithin(vertices, x, y) {
  let within = false;
  vertices.forEach(([x1, y1], i) => {
    const [x0, y0] = vertices.at(i - 1);
    if (y0 > y !== y1 > y && x < x0 + ((y - y0) / (y1 - y0)) * (x1 - x0)) within = !within;
  });
  return within;
}
