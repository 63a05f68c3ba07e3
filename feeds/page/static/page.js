// Puts the page together: frames to the picture, the picture to display, strips and tables, wishes back.

import { Address } from "./address.js";
import { showCard, showLegend } from "./card.js";
import { Cards } from "./cards.js";
import { readColours, setTheme, startTheme } from "./colours.js";
import { byId } from "./common.js";
import { showConnections } from "./connect.js";
import { Display } from "./display.js";
import { Feed } from "./feed.js";
import { showFleet } from "./fleet.js";
import { FrameReader } from "./frames.js";
import { hearKeys, showAbout, showKeys } from "./keys.js";
import { readMap } from "./own_map.js";
import { Past } from "./past.js";
import { Picture } from "./picture.js";
import { Pointer } from "./pointer.js";
import { Roles } from "./roles.js";
import { savePicture } from "./save_picture.js";
import { Score } from "./score.js";
import { Sensors } from "./sensors.js";
import { Session } from "./session.js";
import { Stories } from "./stories.js";
import { Strips } from "./strips.js";
import { Tables } from "./tables.js";
import { Timeline } from "./timeline.js";
import { Tour } from "./tour.js";
import { Heights, Trails } from "./trails.js";

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
const roles = new Roles(picture, { ask, onName: look, onTruth: (may) => { if (!may && display.truth) setTruth(false); }, address: () => feed.hello.audience_url });
const cards = new Cards(showCards);
const score = new Score(() => cards.offer("score"));
const tour = new Tour();
const past = new Past(reader);
const timeline = new Timeline(picture, past, display, (command) => session.send(command));
const pointer = new Pointer(display, () => sensors.chosen);
const tables = new Tables(display);
const trails = new Trails(display, picture);
const heights = new Heights();
const address = new Address(display, sensors, trails);
let generation = null;
const UPDATES_PER_S = 10;
const BEHIND_MS = 5000;

function takeFrame(buffer) {
  const frame = reader.read(buffer), plot = !timeline.isBack && display.selected?.kind === "plot" ? picture.plots.told(display.selected.at) : null;
  const changed = picture.take(frame, performance.now());
  const all = changed.has("snapshot");
  if (all && plot) display.selectPlot(picture.plots.find(plot)); // rows begin anew
  if (changed.has("scene") && picture.news.generation !== generation) {
    generation = picture.news.generation;
    sensors.newScene();
    byId("glow").value = nearestGlow(picture.news.scene.afterglow_s);
    display.glowMs = 1000 * Number(byId("glow").value);
    display.newScene();
    trails.clear();
    past.clear();
    timeline.toNow();
    address.apply();
    showLegend(display.truth, picture.news.scene);
    tour.tell(picture.news.scene.about.words);
    showAbout(picture.news.scene.about);
  }
  if (changed.has("covers")) display.redraw();
  past.keep(buffer, frame, picture);
  trails.note(frame.nowMs);
  timeline.tick();
  if (changed.has("missed_updates")) showBehind(picture.news.missed_updates);
  if (all || changed.has("audience") || changed.has("actions")) roles.show();
  if (all || changed.has("connect")) showConnections(picture.news, sensors.chosen);
  if (all || changed.has("session") || changed.has("scene") || changed.has("audience")) { session.show(); timeline.show(); }
  if (["snapshot", "stories", "undoes", "session", "audience"].some((key) => changed.has(key))) stories.show();
  if (all || changed.has("settings") || changed.has("session") || changed.has("audience")) sensors.showSettings();
  if (changed.has("pointing")) sensors.showPointing();
  if ((all || changed.has("fleet")) && picture.news.fleet) { showFleet(picture.news.fleet); cards.offer("fleet"); }
  if (all || changed.has("score")) score.take(display.truth ? picture.score : null);
  if (all || changed.has("refusal") || changed.has("track_problem")) session.showRefusal();
  if (all || changed.has("seconds")) { sensors.showRates(); session.showTotals(); showClosely(); }
  if (all || changed.has("seconds") || changed.has("details") || changed.has("marks")) strips.draw(picture, sensors.chosen);
}

/** What is told once a second beside the picture, if it is open. */
function showClosely() {
  timeline.show();
  tables.show();
  heights.show(display, sensors.chosen);
}

function nearestGlow(seconds) {
  return [...byId("glow").options].map((option) => option.value).reduce((a, b) => (Math.abs(b - seconds) < Math.abs(a - seconds) ? b : a));
}

function look() {
  feed.look({ truth: display.truth, watch: sensors.chosen ? [sensors.chosen] : [], name: roles.name });
  showConnections(picture.news, sensors.chosen);
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
    trails.forgetTruth();
    score.take(null);
    if (display.selected?.kind === "drone") display.select(null);
  }
  showLegend(shown, picture.news.scene);
  refreshCard();
  tables.show();
  look();
}

function refreshCard() {
  const nowMs = display.picture.nowMs(performance.now());
  if (!showCard(display.picture, display.selected, { truth: display.truth, nowMs }) && display.selected && display.selected.kind !== "drone") display.selected = null;
}

/** Something about the picture is said for as long as nothing else is. */
function sayOfPicture(words) {
  byId("picture-said").textContent = words;
}

async function showOwnMap() {
  const [file] = byId("own-map").files;
  byId("own-map").value = "";
  if (!file) return;
  try {
    display.showOwnMap(await readMap(file));
    sayOfPicture(`Map: ${file.name}`);
  } catch (error) {
    sayOfPicture(error.message);
  }
}

function toggleFullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.querySelector(".display").requestFullscreen().catch(() => sayOfPicture("This browser shows nothing on the whole screen."));
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

/** Cards were opened, closed or moved: the strips may have another size. */
function showCards() {
  for (const name of ["help", "connect", "table", "heights"]) byId(`${name}-button`).setAttribute("aria-expanded", String(cards.isOpen(name)));
  strips.draw(picture, sensors.chosen);
  showClosely();
}

function showTheme() {
  byId("theme").textContent = document.documentElement.dataset.theme === "dark" ? "Light" : "Dark";
  showLegend(display.truth, picture.news.scene);
  display.redraw();
  strips.draw(picture, sensors.chosen);
}

const MOVE = "moves the display";
const KEYS = {
  ArrowLeft: [MOVE, () => display.pan(60, 0)],
  ArrowRight: [MOVE, () => display.pan(-60, 0)],
  ArrowUp: [MOVE, () => display.pan(0, 60)],
  ArrowDown: [MOVE, () => display.pan(0, -60)],
  "+": ["zooms in", () => display.zoom(1.25)],
  "=": ["", () => display.zoom(1.25)],
  "-": ["zooms out", () => display.zoom(0.8)],
  0: ["shows all sensors", () => display.home()],
  n: ["selects the next plot", () => display.selectNext(1)],
  p: ["selects the plot before", () => display.selectNext(-1)],
  f: ["follows what is selected", follow],
  t: ["shows or hides the truth", () => setTruth(!display.truth)],
  u: ["takes back what was asked last", () => byId("undo").click()],
  " ": ["pauses, or goes on", () => byId("pause").click()],
  ".": ["makes a step", () => byId("step").click()],
  "[": ["looks further back, or moves a replay back", () => timeline.step(1)],
  "]": ["looks less far back, or moves a replay ahead", () => timeline.step(-1)],
  l: ["goes back to now", () => timeline.toNow()],
  r: ["measures between two places", () => pointer.rule()],
  b: ["opens or closes the table", () => cards.show("table", !cards.isOpen("table"))],
  h: ["opens or closes the heights", () => cards.show("heights", !cards.isOpen("heights"))],
  Escape: ["ends a selection, or the ruler", () => (pointer.ruling ? pointer.rule(false) : display.select(null))],
  "?": ["opens or closes this help", () => cards.show("help", !cards.isOpen("help"))],
}; // what the help says of each, and what it does

hearKeys(KEYS);
for (const button of document.querySelectorAll("[data-key]")) button.addEventListener("click", KEYS[button.dataset.key][1]);
byId("glow").addEventListener("change", () => { display.glowMs = 1000 * Number(byId("glow").value); });
byId("full-screen").addEventListener("click", toggleFullScreen);
document.addEventListener("fullscreenchange", () => byId("full-screen").setAttribute("aria-pressed", String(Boolean(document.fullscreenElement))));
byId("save-picture").addEventListener("click", () => savePicture(byId("screen"), { scene: picture.news.scene, hidden: display.hidden, nowMs: display.picture.nowMs(performance.now()), rings: display.rings }));
byId("own-map").addEventListener("change", showOwnMap);
byId("grid").addEventListener("change", () => { display.grid = byId("grid").value; display.redraw(); });
byId("connect-button").addEventListener("click", () => cards.show("connect", !cards.isOpen("connect")));
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
addEventListener("resize", () => { readColours(); strips.draw(picture, sensors.chosen); }); // words are larger in a large window
setInterval(() => { session.showTime(picture.nowMs(performance.now())); refreshCard(); showFollowing(); }, 100);

showKeys(KEYS);
showCards();
showTheme();
setTruth(false);
session.showTotals();
feed.start();
globalThis.plotfeed = { picture, display, feed, reader, past, trails }; // for tests, and for the curious
