// A map of the user's own: a GeoJSON file (RFC 7946) that this browser reads and shows, and sends to nobody.

import { toPlane } from "./earth.js";

const MOST_OCTETS = 32 << 20;
const MOST_VERTICES = 300_000;
const MOST_DEPTH = 8;
// Of each geometry what its parts are, and how many lists deep they lie in its coordinates.
const GEOMETRIES = { Point: ["points", 0], MultiPoint: ["points", 1], LineString: ["lines", 0], MultiLineString: ["lines", 1], Polygon: ["areas", 1], MultiPolygon: ["areas", 2] };

/** The tree in a file; raises an Error that says what was expected. */
export async function readMap(file) {
  if (file.size > MOST_OCTETS) throw new Error(`${file.name}: larger than 32 MiB`);
  try {
    return JSON.parse(await file.text());
  } catch {
    throw new Error(`${file.name}: expected GeoJSON`);
  }
}

/** Lines, areas and points of a tree as metres east and north of the site; raises an Error. */
export function shapesOf(tree, site) {
  const shapes = { lines: [], areas: [], points: [] };
  let vertices = 0;
  for (const [kind, positions, name] of parts(tree, "", 0)) {
    vertices += positions.length;
    if (vertices > MOST_VERTICES) throw new Error(`more than ${MOST_VERTICES} vertices: simplify it`);
    const flat = positions.flatMap((position) => placed(position, site));
    shapes[kind].push(kind === "points" ? [...flat, name] : flat);
  }
  return shapes;
}

function placed(position, site) {
  const [longitude, latitude] = Array.isArray(position) ? position : [];
  if (![longitude, latitude].every(Number.isFinite) || Math.abs(latitude) > 90 || Math.abs(longitude) > 540) throw new Error("coordinates: expected longitudes and latitudes in degrees (WGS-84)");
  return toPlane(site, latitude, longitude);
}

function listed(found) {
  if (!Array.isArray(found) || !found.length) throw new Error("expected GeoJSON: lists of features and coordinates");
  return found;
}

function* parts(tree, name, depth) {
  if (depth > MOST_DEPTH || typeof tree !== "object" || tree === null) throw new Error("expected GeoJSON: an object with a type");
  const { type, coordinates, properties } = tree;
  if (type === "FeatureCollection") for (const feature of listed(tree.features)) yield* parts(feature, "", depth + 1);
  else if (type === "Feature") { if (tree.geometry) yield* parts(tree.geometry, String(properties?.name ?? "").slice(0, 80), depth + 1); }
  else if (type === "GeometryCollection") for (const geometry of listed(tree.geometries)) yield* parts(geometry, name, depth + 1);
  else if (!(type in GEOMETRIES) || !coordinates) throw new Error(`expected a GeoJSON geometry, not a type ${JSON.stringify(type)}`);
  else {
    const [kind, deep] = GEOMETRIES[type];
    let found = [listed(coordinates)];
    for (let level = 0; level < deep; level++) found = found.flatMap(listed);
    for (const part of found) yield [kind, kind === "points" ? [part] : listed(part), name];
  }
}
