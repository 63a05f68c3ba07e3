// A map of the user's own: a GeoJSON file (RFC 7946) that this browser reads and shows, and sends to nobody.

const MOST_OCTETS = 32 << 20;
const MOST_VERTICES = 300_000;
const MOST_DEPTH = 8;
const RADIANS = Math.PI / 180;
const SEMI_MAJOR_M = 6_378_137, ECCENTRICITY_2 = 6.694_379_990_14e-3; // WGS-84, NIMA TR8350.2

/** East, north and up axes of a place, and its position from the middle of the Earth. */
function frameAt({ latitude_deg, longitude_deg, height_m }) {
  const [sp, cp, sl, cl] = [Math.sin(latitude_deg * RADIANS), Math.cos(latitude_deg * RADIANS), Math.sin(longitude_deg * RADIANS), Math.cos(longitude_deg * RADIANS)];
  return { origin: ecef(longitude_deg, latitude_deg, height_m), east: [-sl, cl, 0], north: [-sp * cl, -sp * sl, cp], height_m };
}

function ecef(longitudeDeg, latitudeDeg, heightM) {
  const s = Math.sin(latitudeDeg * RADIANS), c = Math.cos(latitudeDeg * RADIANS), normal = SEMI_MAJOR_M / Math.sqrt(1 - ECCENTRICITY_2 * s * s);
  return [(normal + heightM) * c * Math.cos(longitudeDeg * RADIANS), (normal + heightM) * c * Math.sin(longitudeDeg * RADIANS), (normal * (1 - ECCENTRICITY_2) + heightM) * s];
}

function placed(position, { origin, east, north, height_m }) {
  const [longitude, latitude] = Array.isArray(position) ? position : [];
  if (!(Math.abs(latitude) <= 90) || !(Math.abs(longitude) <= 540)) throw new Error("coordinates: expected longitudes and latitudes in degrees (WGS-84)");
  const at = ecef(longitude, latitude, height_m).map((value, i) => value - origin[i]);
  return [east, north].map((axis) => axis[0] * at[0] + axis[1] * at[1] + axis[2] * at[2]);
}

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
  const shapes = { lines: [], areas: [], points: [] }, frame = frameAt(site);
  let vertices = 0;
  for (const [kind, positions, name] of parts(tree, "", 0)) {
    vertices += positions.length;
    if (vertices > MOST_VERTICES) throw new Error(`more than ${MOST_VERTICES} vertices: simplify it`);
    const flat = positions.flatMap((position) => placed(position, frame));
    shapes[kind].push(kind === "points" ? [...flat, name] : flat);
  }
  return shapes;
}

function* parts(tree, name, depth) {
  if (depth > MOST_DEPTH || typeof tree !== "object" || tree === null) throw new Error("expected GeoJSON: an object with a type");
  const found = tree.coordinates;
  if (tree.type === "FeatureCollection") for (const feature of tree.features ?? []) yield* parts(feature, "", depth + 1);
  else if (tree.type === "Feature") { if (tree.geometry) yield* parts(tree.geometry, String(tree.properties?.name ?? "").slice(0, 80), depth + 1); }
  else if (tree.type === "GeometryCollection") for (const geometry of tree.geometries ?? []) yield* parts(geometry, name, depth + 1);
  else if (!Array.isArray(found)) throw new Error(`expected a GeoJSON geometry, not a type ${JSON.stringify(tree.type)}`);
  else if (tree.type === "Point") yield ["points", [found], name];
  else if (tree.type === "MultiPoint") for (const point of found) yield ["points", [point], name];
  else if (tree.type === "LineString") yield ["lines", found, name];
  else if (tree.type === "MultiLineString") for (const line of found) yield ["lines", line, name];
  else if (tree.type === "Polygon") for (const ring of found) yield ["areas", ring, name];
  else if (tree.type === "MultiPolygon") for (const polygon of found) for (const ring of polygon) yield ["areas", ring, name];
  else throw new Error(`expected a GeoJSON geometry, not a type ${JSON.stringify(tree.type)}`);
}
