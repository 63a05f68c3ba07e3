// Puts the page together: frames to the picture, the picture to display, strips and tables, wishes back.

import { showCard, showLegend } from "./card.js";
import { setTheme, startTheme } from "./colours.js";
import { Display } from "./display.js";
import { Feed } from "./feed.js";
import { FrameReader } from "./frames.js";
import { Picture } from "./picture.js";
import { Sensors } from "./sensors.js";
import { Session } from "./session.js";
import { Stories } from "./stories.js";
import { Strips } from "./strips.js";

const byId = (id) => document.getElementById(id);
const reader = new FrameReader();
const picture = new Picture();
startTheme();
const display = new Display(picture, () => { showFollowing(); refreshCard(); });
const feed = new Feed(takeFrame, showConnection);
const ask = (command) => feed.ask(command);
const sensors = new Sensors(picture, display.hidden, { ask, onChoose: look, onHide: () => display.redraw() });
const session = new Session(picture, ask);
const stories = new Stories(picture, ask);
const strips = new Strips();
let generation = null;
const UPDATES_PER_S = 10;
const BEHIND_MS = 5000;

function takeFrame(buffer) {
  const frame = reader.read(buffer), plot = display.selected?.kind === "plot" ? picture.plots.told(display.selected.at) : null;
  const changed = picture.take(frame, performance.now());
  const all = changed.has("snapshot");
  if (all && plot) display.selectPlot(picture.plots.find(plot)); // rows begin anew
  if (changed.has("scene") && picture.news.generation !== generation) {
    generation = picture.news.generation;
    sensors.newScene();
    byId("glow").value = nearestGlow(picture.news.scene.afterglow_s);
    display.glowMs = 1000 * Number(byId("glow").value);
    display.newScene();
  }
  if (changed.has("missed_updates")) showBehind(picture.news.missed_updates);
  if (all || changed.has("session") || changed.has("scene")) session.show();
  if (["snapshot", "stories", "undoes", "session"].some((key) => changed.has(key))) stories.show();
  if (all || changed.has("settings") || changed.has("session")) sensors.showSettings();
  if (all || changed.has("refusal") || changed.has("track_problem")) session.showRefusal();
  if (all || changed.has("seconds")) { sensors.showRates(); session.showTotals(); }
  if (all || changed.has("seconds") || changed.has("details") || changed.has("marks")) strips.draw(picture, sensors.chosen);
}

function nearestGlow(seconds) {
  return [...byId("glow").options].map((option) => option.value).reduce((a, b) => (Math.abs(b - seconds) < Math.abs(a - seconds) ? b : a));
}

function look() {
  feed.look({ truth: display.truth, watch: sensors.chosen ? [sensors.chosen] : [] });
}

let behind = "", behindUntil = 0;

/** Said for some seconds: this browser took updates too slowly, and some were left out. */
function showBehind(missed) {
  behind = `Connected; ${(missed / UPDATES_PER_S).toFixed(1)} s of updates were too fast for here`;
  behindUntil = performance.now() + BEHIND_MS;
}

function showConnection(state, told) {
  const box = byId("connection"), words = state === "open" && performance.now() < behindUntil ? behind : told;
  if (box.dataset.state === state && box.textContent === words) return;
  box.dataset.state = state;
  box.textContent = words;
  byId("veil").hidden = state !== "lost";
  byId("veil-text").textContent = state === "lost" ? words : "";
}

function setTruth(shown) {
  display.truth = shown;
  byId("truth").setAttribute("aria-pressed", String(shown));
  if (!shown) {
    picture.forgetTruth();
    if (display.selected?.kind === "drone") display.select(null);
  }
  showLegend(shown);
  refreshCard();
  look();
}

function refreshCard() {
  const nowMs = picture.nowMs(performance.now());
  if (!showCard(picture, display.selected, { truth: display.truth, nowMs }) && display.selected && display.selected.kind !== "drone") display.selected = null;
}

function follow() {
  const { selected } = display;
  display.following = !display.following && Boolean(selected) && selected.kind !== "plot";
  showFollowing();
}

function showFollowing() {
  byId("follow").setAttribute("aria-pressed", String(display.following));
  byId("follow").disabled = !display.selected || display.selected.kind === "plot";
}

function showTheme() {
  byId("theme").textContent = document.documentElement.dataset.theme === "dark" ? "Light" : "Dark";
  showLegend(display.truth);
  display.redraw();
  strips.draw(picture, sensors.chosen);
}

const KEYS = {
  ArrowLeft: () => display.pan(60, 0),
  ArrowRight: () => display.pan(-60, 0),
  ArrowUp: () => display.pan(0, 60),
  ArrowDown: () => display.pan(0, -60),
  "+": () => display.zoom(1.25),
  "=": () => display.zoom(1.25),
  "-": () => display.zoom(0.8),
  0: () => display.home(),
  n: () => display.selectNext(1),
  p: () => display.selectNext(-1),
  f: follow,
  t: () => setTruth(!display.truth),
  u: () => stories.undo(),
  " ": () => session.togglePause(),
  ".": () => session.step(),
  Escape: () => display.select(null),
};

byId("display").addEventListener("keydown", (event) => {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (!KEYS[key] || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  KEYS[key]();
});
byId("zoom-in").addEventListener("click", () => display.zoom(1.4));
byId("zoom-out").addEventListener("click", () => display.zoom(1 / 1.4));
byId("home").addEventListener("click", () => display.home());
byId("follow").addEventListener("click", follow);
byId("truth").addEventListener("click", () => setTruth(!display.truth));
byId("glow").addEventListener("change", () => { display.glowMs = 1000 * Number(byId("glow").value); });
byId("theme").addEventListener("click", () => {
  setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  showTheme();
});
for (const layer of Object.keys(display.layers)) {
  byId(`show-${layer}`).addEventListener("change", (event) => {
    display.layers[layer] = event.target.checked;
    display.redraw();
  });
}
addEventListener("resize", () => strips.draw(picture, sensors.chosen));
setInterval(() => { session.showTime(picture.nowMs(performance.now())); refreshCard(); showFollowing(); }, 100);

showTheme();
setTruth(false);
session.showTotals();
feed.start();
globalThis.plotfeed = { picture, display, feed, reader }; // for tests, and for the curious
