// The picture as a PNG file: what is seen, with a line of which scene and when, and whose the marks are.

import { colours, sensorColour } from "./colours.js";
import { shapeOf, traceShape } from "./shapes.js";

const LINE = 26; // pixels high
const SWATCH = 5; // half the width of a shape

/** Save it, under the name of the scene and the session's time; `rings` says how far apart they are. */
export async function savePicture(canvas, { scene, hidden, nowMs, rings }) {
  const image = draw(canvas, { scene, hidden, nowMs, rings }), blob = await new Promise((done) => image.toBlob(done, "image/png"));
  const link = document.createElement("a"), url = URL.createObjectURL(blob);
  link.download = `plotfeed-${scene?.name ?? "page"}-${new Date(nowMs).toISOString().slice(0, 19).replaceAll(/[-:]/g, "")}Z.png`;
  link.href = url;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

function draw(canvas, { scene, hidden, nowMs, rings }) {
  const dpr = devicePixelRatio || 1, image = document.createElement("canvas"), context = image.getContext("2d");
  const wide = canvas.width / dpr, high = canvas.height / dpr;
  image.width = canvas.width;
  image.height = Math.round((high + 2 * LINE) * dpr);
  context.scale(dpr, dpr);
  context.fillStyle = colours.panel;
  context.fillRect(0, 0, wide, high + 2 * LINE);
  context.drawImage(canvas, 0, 0, wide, high);
  context.font = colours.font;
  context.textBaseline = "middle";
  context.fillStyle = colours.ink;
  context.fillText(`plotfeed · ${scene?.name ?? ""} · ${new Date(nowMs).toISOString().replace("T", " ").slice(0, 21)} UTC · ${rings} · north is up`, 10, high + LINE / 2);
  let x = 10;
  (scene?.sensors ?? []).forEach((sensor, number) => {
    if (hidden.has(sensor.id)) return;
    const words = `${sensor.id} · ${sensor.label}`;
    context.fillStyle = sensorColour(number);
    traceShape(context, shapeOf(sensor.type), x + SWATCH, high + 1.4 * LINE, SWATCH);
    context.fill();
    context.fillStyle = colours.quiet;
    context.fillText(words, x + 3 * SWATCH, high + 1.4 * LINE);
    x += 3 * SWATCH + context.measureText(words).width + 14;
  });
  return image;
}
