// Plots on the Earth with MQTT.js: one line for each plot.
//
//   npm install mqtt protobufjs
//   node examples/plots.mjs [URL [PREFIX]]
//
// Range and angles of a plot count from its sensor, whose place is in the description that is
// retained on PREFIX/SENSOR/description, so that whoever comes later has it too. Packages are
// looked for beside this file; NODE_MODULES names another folder of them.
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const modules = process.env.NODE_MODULES;
const load = createRequire(modules ? `${modules}/` : import.meta.url);
const mqtt = load("mqtt");
const protobuf = load("protobufjs");

const [url = "mqtt://127.0.0.1:1883", prefix = "plotfeed"] = process.argv.slice(2);
const layout = fileURLToPath(new URL("../proto/plotfeed.proto", import.meta.url));
const PlotBatch = (await protobuf.load(layout)).lookupType("plotfeed.v1.PlotBatch");

// WGS-84: semi-major axis in metres, first eccentricity squared.
const A = 6378137;
const E2 = 0.00669437999014;
const RAD = Math.PI / 180;

function ecef({ latitude_deg, longitude_deg, height_m }) {
  const [lat, lon] = [latitude_deg * RAD, longitude_deg * RAD];
  const n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  const axis = (n + height_m) * Math.cos(lat);
  return [axis * Math.cos(lon), axis * Math.sin(lon), (n * (1 - E2) + height_m) * Math.sin(lat)];
}

function geodetic([x, y, z]) {
  const axis = Math.hypot(x, y);
  let lat = Math.atan2(z, axis * (1 - E2));
  let n = A;
  for (let step = 0; step < 5; step++) {
    n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
    lat = Math.atan2(z + E2 * n * Math.sin(lat), axis);
  }
  const height_m = axis * Math.cos(lat) + z * Math.sin(lat) - A * A / n;
  return [lat / RAD, Math.atan2(y, x) / RAD, height_m];
}

// From azimuth clockwise from north, elevation above the sensor's horizontal, and slant range.
function onTheEarth(sensor, azimuth_deg, elevation_deg, range_m) {
  const ground = range_m * Math.cos(elevation_deg * RAD);
  const east = ground * Math.sin(azimuth_deg * RAD);
  const north = ground * Math.cos(azimuth_deg * RAD);
  const up = range_m * Math.sin(elevation_deg * RAD);
  const [lat, lon] = [sensor.latitude_deg * RAD, sensor.longitude_deg * RAD];
  const out = up * Math.cos(lat) - north * Math.sin(lat);
  const [x, y, z] = ecef(sensor);
  return geodetic([
    x + out * Math.cos(lon) - east * Math.sin(lon),
    y + out * Math.sin(lon) + east * Math.cos(lon),
    z + up * Math.sin(lat) + north * Math.cos(lat),
  ]);
}

const sensors = new Map();
const client = mqtt.connect(url);
client.on("connect", () => {
  client.subscribe(`${prefix}/+/description`, { qos: 1 });
  client.subscribe(`${prefix}/+/plots`);
});
client.on("error", (error) => console.error(error.message));
client.on("message", (topic, payload) => {
  if (topic.endsWith("/description")) {
    const told = JSON.parse(payload.toString());
    sensors.set(told.sensor, told);
    return;
  }
  const batch = PlotBatch.decode(payload);
  const sensor = sensors.get(batch.sensor);
  for (const plot of sensor ? batch.plots : []) {
    if (!Object.hasOwn(plot, "rangeM") || !Object.hasOwn(plot, "azimuthDeg")) continue;
    // A sensor that measures no elevation has 0 here: its plots lie on its horizontal.
    const [latitude, longitude, height_m] = onTheEarth(
      sensor, plot.azimuthDeg, plot.elevationDeg, plot.rangeM,
    );
    const time = new Date(Number(plot.timeUtcNs) / 1e6).toISOString().slice(11, 23);
    const place = `${latitude.toFixed(6)} ${longitude.toFixed(6)} ${height_m.toFixed(0)} m`;
    console.log(`${time} ${batch.sensor.padEnd(10)} ${place}`);
  }
});
