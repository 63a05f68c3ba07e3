// The place under the pointer in words, what is known of the mark there, and a ruler between two places.

import { describe } from "./card.js";
import { colours } from "./colours.js";
import { byId, element, line } from "./common.js";
import { toGeodetic } from "./earth.js";
import { inKilometres } from "./ground.js";
import { drawWords } from "./labels.js";
import { placeOf } from "./marks.js";
import { azimuthOf } from "./viewport.js";

const LOOK_EVERY_MS = 60;
const MOST_ROWS = 7; // of the card; all of them are in that of what is selected

function fromPlace(name, east, north) {
  return `${name} ${azimuthOf(east, north).toFixed(1).padStart(5, "0")}° ${(Math.hypot(east, north) / 1000).toFixed(2)} km`;
}

export class Pointer {
  #ends = []; // of the ruler: at most two, each {place: [east, north]} or {mark}
  #at = null; // the pointer, in pixels
  #lookedAt = 0;

  /** chosen() gives the id of the sensor from which places are told, too. */
  constructor(display, chosen) {
    Object.assign(this, { display, chosen, ruling: false });
    display.extras.push((context, view, picture, nowMs) => this.#drawRuler(context, view, picture, nowMs));
    display.onPoint = (x, y) => this.#point(x, y);
    display.onPress = (x, y) => this.ruling && this.#measure(x, y);
  }

  /** Begin to measure, or measure no more. */
  rule(ruling = !this.ruling) {
    this.ruling = ruling;
    this.#ends = [];
    byId("ruler").setAttribute("aria-pressed", String(ruling));
    byId("ruler-text").textContent = ruling ? "Ruler: press two places or marks." : "";
    this.display.refresh();
  }

  /** The first place, or the second, or the first of another. */
  #measure(x, y) {
    const mark = this.display.hit(x, y), { view } = this.display;
    if (this.#ends.length === 2) this.#ends = [];
    this.#ends.push(mark ? { mark } : { place: [view.eastAt(x), view.northAt(y)] });
    this.display.refresh();
    return true;
  }

  #place(end, picture, nowMs) {
    const place = end.mark ? placeOf(picture, end.mark, nowMs) : end.place;
    if (place) end.last = place; // where a mark was last that has gone
    return end.last;
  }

  #drawRuler(context, view, picture, nowMs) {
    if (!this.#ends.length) return;
    const [from, to] = this.#ends.map((end) => this.#place(end, picture, nowMs));
    const second = to ?? (this.#at && [view.eastAt(this.#at.x), view.northAt(this.#at.y)]);
    if (!from || !second) return;
    const [east, north] = [second[0] - from[0], second[1] - from[1]];
    const words = `${inKilometres(Math.hypot(east, north))}  ${azimuthOf(east, north).toFixed(1)}°`;
    if (to) byId("ruler-text").textContent = `Ruler: ${words}`;
    const [x0, y0, x1, y1] = [view.x(from[0]), view.y(from[1]), view.x(second[0]), view.y(second[1])];
    context.strokeStyle = colours.accent;
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    line(context, x0, y0, x1, y1);
    context.setLineDash([]);
    for (const [x, y] of [[x0, y0], [x1, y1]]) context.strokeRect(x - 3, y - 3, 6, 6);
    context.font = colours.font;
    context.textAlign = "center";
    context.textBaseline = "middle";
    drawWords(context, words, (x0 + x1) / 2, (y0 + y1) / 2 - 10, colours.accent);
  }

  #point(x, y) {
    this.#at = x === null ? null : { x, y };
    if (this.ruling && this.#ends.length === 1) this.display.refresh();
    this.#sayPlace();
    if (x === null) this.#hover(null);
    else if (performance.now() - this.#lookedAt > LOOK_EVERY_MS) this.#hover(this.display.hit(x, y));
  }

  #sayPlace() {
    const { view, picture } = this.display, scene = picture.news.scene, words = byId("cursor");
    if (!this.#at || !scene) {
      words.textContent = "";
      return;
    }
    const east = view.eastAt(this.#at.x), north = view.northAt(this.#at.y);
    const [latitude, longitude] = toGeodetic(scene.site, east, north);
    const told = [
      `${latitude.toFixed(5)}°, ${longitude.toFixed(5)}°`,
      `E ${east.toFixed(0)} m, N ${north.toFixed(0)} m`,
      fromPlace("site", east, north),
    ];
    const sensor = scene.sensors.find(({ id }) => id === this.chosen());
    if (sensor) told.push(fromPlace(sensor.id, east - sensor.east_m, north - sensor.north_m));
    words.textContent = told.join("  ·  ");
  }

  /** The card beside the pointer; nothing of the truth is in it that is not shown. */
  #hover(mark) {
    this.#lookedAt = performance.now();
    const { display } = this, box = byId("hover"), nowMs = display.picture.nowMs(this.#lookedAt);
    const found = mark && describe(display.picture, mark, display.truth, nowMs);
    box.hidden = !found;
    if (!found) return;
    const rows = found.rows.slice(0, MOST_ROWS).map(([name, ...values]) => `${name} ${values.filter(Boolean).join(" · ")}`.trim());
    box.replaceChildren(...[found.title, ...rows].map((words) => element("div", words)));
    const { view } = display, left = Math.min(this.#at.x + 14, view.width - box.offsetWidth - 4), below = this.#at.y + 16;
    box.style.left = `${Math.max(left, 0)}px`;
    box.style.top = `${below + box.offsetHeight > view.height ? Math.max(this.#at.y - box.offsetHeight - 12, 0) : below}px`;
  }
}
