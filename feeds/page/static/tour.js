// What a stranger sees first: a line of words about the scene, and a tour of the page in its place, which can
// be skipped and is not shown again.

import { byId, keep, kept } from "./common.js";

const KEPT = "plotfeed-tour";
const STEPS = [
  ["display", "This is the site from above, north up. Each small mark is what a sensor reported; it fades as it grows old. A ray is a bearing alone."],
  ["sensors-title", "Each sensor has a colour, and each kind of sensor a shape. Choose one here to look at it closely."],
  ["sensor-title", "Make its link late or lossy, or the sensor blind, and apply it: the broker's messages change at once, and the picture with them."],
  ["strips-title", "What the link and the sensor were asked for, beside what came out: latency, losses, detections."],
  ["truth", "This shows the drones as they truly are, false alarms and what was lost. A tracker team had better not see it first."],
  ["pause", "The session's clock: where it is simulated, it can be held, stepped and hurried."],
  ["help-button", "Everything beside the picture is a card: press its head to fold it away, or to open it again. Help has the keys."],
];

export class Tour {
  #step = -1;
  #words = "";

  constructor() {
    byId("tour-next").addEventListener("click", () => this.#go(this.#step + 1));
    byId("tour-skip").addEventListener("click", () => this.#go(STEPS.length));
    byId("tour-start").addEventListener("click", () => this.#go(0));
    if (kept(KEPT) !== "seen") this.#go(0);
  }

  /** The words of another scene, which stand there without the tour. */
  tell(words) {
    this.#words = words;
    this.#show();
  }

  #go(step) {
    this.#step = step < STEPS.length ? step : -1;
    if (this.#step < 0) keep(KEPT, "seen");
    this.#show();
    if (step > 0 && this.#step >= 0) partOf(this.#step).scrollIntoView({ block: "nearest" });
  }

  #show() {
    const on = this.#step >= 0;
    for (const marked of document.querySelectorAll(".toured")) marked.classList.remove("toured");
    byId("tour").hidden = !on;
    byId("words").textContent = on ? `${this.#step + 1} of ${STEPS.length}: ${STEPS[this.#step][1]}` : this.#words;
    if (!on) return;
    partOf(this.#step).classList.add("toured");
    byId("tour-next").textContent = this.#step === STEPS.length - 1 ? "Done" : "Next";
  }
}

/** What a step is about: the whole card, where it is the head of one. */
function partOf(step) {
  const part = byId(STEPS[step][0]);
  return part.closest("[data-card]") ?? part;
}
