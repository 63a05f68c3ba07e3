// Places on the Earth by WGS-84 (NIMA TR8350.2), and on the horizontal plane of a site.

const AXIS_M = 6_378_137, FLATTENING = 1 / 298.257223563, E2 = FLATTENING * (2 - FLATTENING);
const MINOR_M = AXIS_M * (1 - FLATTENING), SECOND_E2 = E2 / (1 - E2);
const rad = Math.PI / 180;

function ecef(latitude, longitude, height) {
  const s = Math.sin(latitude * rad), c = Math.cos(latitude * rad), normal = AXIS_M / Math.sqrt(1 - E2 * s * s);
  return [(normal + height) * c * Math.cos(longitude * rad), (normal + height) * c * Math.sin(longitude * rad), (normal * (1 - E2) + height) * s];
}

/** The horizontal plane of a site: its middle, and which way east and north are. */
function planeOf({ latitude_deg: latitude, longitude_deg: longitude, height_m: height }) {
  const [sf, cf, sl, cl] = [Math.sin(latitude * rad), Math.cos(latitude * rad), Math.sin(longitude * rad), Math.cos(longitude * rad)];
  return { middle: ecef(latitude, longitude, height), east: [-sl, cl, 0], north: [-sf * cl, -sf * sl, cf] };
}

/** Metres east and north of a site, of a place at its height. */
export function toPlane(site, latitude, longitude) {
  const { middle, east, north } = planeOf(site), at = ecef(latitude, longitude, site.height_m).map((value, i) => value - middle[i]);
  return [east, north].map((axis) => axis[0] * at[0] + axis[1] * at[1] + axis[2] * at[2]);
}

/** Latitude and longitude, degrees, of a place so far east and north on the plane of a site. */
export function toGeodetic(site, eastM, northM) {
  const { middle, east, north } = planeOf(site), [x, y, z] = middle.map((value, i) => value + eastM * east[i] + northM * north[i]);
  const p = Math.hypot(x, y), theta = Math.atan2(z * AXIS_M, p * MINOR_M); // Bowring (1976)
  const latitude = Math.atan2(z + SECOND_E2 * MINOR_M * Math.sin(theta) ** 3, p - E2 * AXIS_M * Math.cos(theta) ** 3);
  return [latitude / rad, Math.atan2(y, x) / rad];
}
