// The plan-position display: its layers, what the mouse and the keys do there, and a loop of frames.

import { byId } from "./common.js";
import { hearGestures } from "./gestures.js";
import { drawGround, inKilometres, ringSpacing } from "./ground.js";
import { dronePlace, drawMarks, drawMoving, placeOf, trackPlace } from "./marks.js";
import { shapesOf } from "./own_map.js";
import { Pixels } from "./pixels.js";
import { Viewport } from "./viewport.js";

const REACH = 11; // pixels within which a mark is hit
const MARKS_SHARE = 0.06; // of the time, at most, for drawing marks anew
const SHORTEST_STILL_MS = 45;
const LONGEST_STILL_MS = 150;
const CALM_MS = 250; // between pictures, for who wants little motion
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const OVER = ".bar > *, .foot > *, .display > .selected"; // over the picture

/** A layer that is drawn elsewhere and then copied. */
function layer() {
  return document.createElement("canvas").getContext("2d", { alpha: false, willReadFrequently: true });
}

export class Display {
  view = new Viewport();
  hidden = new Set(); // ids of sensors
  layers = { cover: true, sweep: true, labels: true, tracks: true, basemap: true };
  truth = false;
  glowMs = 10_000;
  grid = "rings"; // or squares, or none
  selected = null;
  following = false;
  framesDrawn = 0;
  extras = []; // what else is drawn over all of it: functions of context, view, picture and time
  onPoint = () => {}; // told where the pointer is, in pixels, or null
  onPress = () => false; // told of a press; true if it was for somebody else than the marks
  placed = []; // rectangles of words and sites that lie still
  words = []; // those, and of the words beside marks
  #box = byId("display");
  #ground = layer(); // what lies still
  #marks = layer(); // ground and marks
  #pixels = new Pixels();
  #screen = byId("screen").getContext("2d", { alpha: false });
  #groundIsOld = true;
  #marksDueAt = 0;
  #basemap = null;
  #ownMap = null; // the tree of a GeoJSON file
  #ownShapes = null;
  isFitted = false; // whether it shows what was asked for, not only what there was before the first scene

  constructor(picture, onSelect) {
    this.picture = picture;
    this.onSelect = onSelect;
    new ResizeObserver(() => this.#resize()).observe(this.#box);
    const covers = new ResizeObserver(() => this.redraw());
    for (const part of document.querySelectorAll(OVER)) covers.observe(part);
    this.#resize();
    hearGestures(this.#box, {
      pan: (dx, dy) => this.pan(dx, dy),
      zoom: (factor, x, y) => this.zoom(factor, x, y),
      point: (x, y) => this.onPoint(x, y),
      press: (x, y) => this.onPress(x, y) || this.select(this.hit(x, y)),
    });
    requestAnimationFrame((at) => this.#draw(at));
  }

  /** What lies still has changed. */
  redraw() {
    this.#groundIsOld = true;
  }

  /** Draw soon: something that is not of the ground has changed. */
  refresh() {
    this.#marksDueAt = 0;
  }

  /** A place in the middle, so many metres a pixel. */
  lookAt(east, north, scale) {
    Object.assign(this.view, { east, north, scale });
    this.isFitted = true;
    this.following = false;
    this.redraw();
  }

  /** Another scene: show all of it, and its basemap. */
  async newScene() {
    this.isFitted = false;
    this.selected = null;
    this.following = false;
    this.#basemap = null;
    this.#placeOwnMap();
    this.redraw();
    const basemap = this.picture.news.scene?.basemap;
    if (!basemap) return;
    const url = `/basemap?${this.picture.news.generation}`;
    if (basemap.corners_m) {
      const image = new Image();
      image.onload = () => { this.#basemap = { image, corners: basemap.corners_m }; this.redraw(); };
      image.src = url;
    } else {
      const shapes = await fetch(url).then((answer) => answer.json(), () => null);
      this.#basemap = shapes && { shapes };
      this.redraw();
    }
  }

  /** A map of the user's own in place of the scene's; raises an Error where it is none. */
  showOwnMap(tree) {
    this.#ownMap = tree;
    this.#placeOwnMap();
    this.redraw();
  }

  #placeOwnMap() {
    const { scene } = this.picture.news, tree = this.#ownMap;
    this.#ownMap = this.#ownShapes = null;
    if (!tree || !scene) return;
    this.#ownShapes = shapesOf(tree, scene.site);
    this.#ownMap = tree;
  }

  /** How far apart the lines of the grid are, in words. */
  get rings() {
    return this.grid === "none" ? "" : `${this.grid} ${inKilometres(ringSpacing(this.view))}`;
  }

  home() {
    const sensors = this.picture.news.scene?.sensors ?? [];
    this.view.fit(sensors.filter((s) => !this.hidden.has(s.id)).map((s) => ({ east: s.east_m, north: s.north_m, radius: s.range_max_m })));
    this.following = false;
    this.redraw();
  }

  zoom(factor, x, y) {
    this.view.zoom(factor, x, y);
    this.redraw();
  }

  pan(dx, dy) {
    this.view.pan(dx, dy);
    this.following = false;
    this.redraw();
  }

  select(selected) {
    this.selected = selected;
    if (!selected || selected.kind === "plot") this.following = false;
    this.onSelect();
  }

  /** The plot of that row, or with -1 none. */
  selectPlot(row) {
    this.select(row < 0 ? null : { kind: "plot", row, at: this.picture.plots.at(row) });
  }

  /** The next newer plot that is shown, or with -1 the next older one. */
  selectNext(step) {
    const { plots } = this.picture, nowMs = this.picture.nowMs(performance.now());
    let row = this.selected?.kind === "plot" ? this.selected.row + step : plots.end - 1;
    for (; plots.holds(row); row += step) {
      const at = plots.at(row), sensor = this.picture.news.scene.sensors[plots.sensor[at]];
      if (nowMs - plots.shown_ms[at] < this.glowMs && sensor && !this.hidden.has(sensor.id)) {
        this.selectPlot(row);
        return;
      }
    }
  }

  #resize() {
    const dpr = devicePixelRatio || 1;
    const clientWidth = Math.max(this.#box.clientWidth, 1), clientHeight = Math.max(this.#box.clientHeight, 1);
    for (const context of [this.#ground, this.#marks, this.#screen]) {
      context.canvas.width = Math.round(clientWidth * dpr);
      context.canvas.height = Math.round(clientHeight * dpr);
      context.setTransform(dpr, 0, 0, dpr, 0, 0);
    }
    this.view.width = clientWidth;
    this.view.height = clientHeight;
    this.redraw();
  }

  #draw(at) {
    requestAnimationFrame((next) => this.#draw(next));
    const nowMs = this.picture.nowMs(at);
    if (!this.isFitted && this.picture.news.scene) {
      this.isFitted = true;
      this.home();
    }
    if (this.following && this.selected) this.#centre(nowMs);
    const due = this.#groundIsOld || at >= this.#marksDueAt;
    if (due) this.#drawMarks(at, nowMs);
    else if (!this.#turns()) return;
    copy(this.#marks, this.#screen);
    drawMoving(this.#screen, this.view, this.picture, nowMs, this);
    for (const extra of this.extras) extra(this.#screen, this.view, this.picture, nowMs);
    this.framesDrawn++;
  }

  /** Whether anything is different in every frame of the screen. */
  #turns() {
    return !calm.matches && this.layers.sweep && this.picture.pace > 0 && (this.picture.news.scene?.sensors.some((sensor) => sensor.rotates) ?? false);
  }

  /** Marks are drawn as often as there is time for, twenty times a second where they are few. */
  #drawMarks(at, nowMs) {
    const began = performance.now();
    if (this.#groundIsOld) {
      this.#groundIsOld = false;
      this.placed = drawGround(this.#ground, this.view, { scene: this.picture.news.scene, hidden: this.hidden, layers: this.layers, basemap: this.#ownShapes ? { shapes: this.#ownShapes } : this.#basemap, grid: this.grid, covered: this.#covered() });
      this.#pixels.setGround(this.#ground);
      byId("scale").textContent = this.rings;
    }
    this.words = drawMarks(this.#marks, this.#pixels, this.view, this.picture, nowMs, this);
    const wait = (performance.now() - began) / MARKS_SHARE;
    this.#marksDueAt = at + Math.min(Math.max(wait, calm.matches ? CALM_MS : SHORTEST_STILL_MS), calm.matches ? CALM_MS : LONGEST_STILL_MS);
  }

  /** What of the page lies over the picture, as rectangles on it. */
  #covered() {
    const { left, top } = this.#box.getBoundingClientRect();
    return [...document.querySelectorAll(OVER)].map((part) => part.getBoundingClientRect()).filter((box) => box.width > 0)
      .map((box) => [box.left - left, box.top - top, box.right - left, box.bottom - top, ""]);
  }

  #centre(nowMs) {
    const place = placeOf(this.picture, this.selected, nowMs);
    if (!place) return;
    const moved = Math.hypot(place[0] - this.view.east, place[1] - this.view.north) / this.view.scale;
    if (moved < 0.5) return;
    [this.view.east, this.view.north] = place;
    this.redraw();
  }

  /** The mark at a place on the screen: drone, track or plot, whichever is nearest. */
  hit(x, y) {
    const nowMs = this.picture.nowMs(performance.now()), { view, picture } = this;
    let best = null, least = REACH;
    const offer = (distance, found) => { if (distance < least) [best, least] = [found, distance]; };
    const away = ([east, north]) => Math.hypot(view.x(east) - x, view.y(north) - y);
    this.#hitPlots(x, y, nowMs, offer);
    if (this.layers.tracks) for (const track of picture.tracks.values()) offer(away(trackPlace(track, nowMs)), { kind: "track", id: track.id });
    const { drones } = picture;
    if (this.truth && drones) for (let i = 0; i < drones.rows; i++) offer(away(dronePlace(drones, i, nowMs)), { kind: "drone", drone: drones.drone[i] });
    return best;
  }

  #hitPlots(x, y, nowMs, offer) {
    const { plots, news } = this.picture, { view } = this;
    for (let row = plots.begin; row < plots.end; row++) {
      const at = plots.at(row), sensor = news.scene?.sensors[plots.sensor[at]];
      if (nowMs - plots.shown_ms[at] >= this.glowMs || !sensor || this.hidden.has(sensor.id) || plots.isNowhere(at)) continue;
      const px = view.x(plots.east_m[at]), py = view.y(plots.north_m[at]);
      const distance = plots.isBearing(at) ? fromSegment(x, y, view.x(sensor.east_m), view.y(sensor.north_m), px, py) + 3 : Math.hypot(px - x, py - y);
      offer(distance, { kind: "plot", row, at });
    }
  }
}

function copy(from, to) {
  const scale = to.getTransform();
  to.setTransform(1, 0, 0, 1, 0, 0);
  to.drawImage(from.canvas, 0, 0);
  to.setTransform(scale);
}

function fromSegment(x, y, x0, y0, x1, y1) {
  const dx = x1 - x0, dy = y1 - y0;
  const share = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1), 0), 1);
  return Math.hypot(x0 + share * dx - x, y0 + share * dy - y);
}
