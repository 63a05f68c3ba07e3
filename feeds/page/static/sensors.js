// The table of sensors, and what can be asked of the one that is chosen.

import { SENSOR_COLOURS } from "./colours.js";
import { byId, element, sayAnswer } from "./common.js";
import { pointingWords } from "./looks.js";
import { refusals } from "./roles.js";
import { shapeOf, swatch } from "./shapes.js";
import { askedLoss } from "./strips.js";

const DEGRADED_PFA = 10; // times
const DEGRADED_LOSS_DB = 6;
const EXAMPLES = { pfa: "1e-6", latency: "250", jitter: "20", loss: "5", burst: "3" };
const power = (value) => (+value.toPrecision(4)).toExponential();
const plain = (value, digits = 4) => (value == null ? "–" : String(+value.toPrecision(digits)));

export class Sensors {
  chosen = null;
  #rows = new Map();
  #dirty = new Set(); // fields that were filled in and not asked for yet
  #entered = null; // the field that somebody is in: what he has selected there is not taken from him
  #asking = 0; // commands without an answer yet

  /** ask(command) gives the session's answer; onChoose() and onHide() tell of changes here. */
  constructor(picture, hidden, { ask, onChoose, onHide }) {
    Object.assign(this, { picture, hidden, ask, onChoose, onHide });
    const form = byId("sensor-form");
    form.addEventListener("input", (event) => {
      if (event.target.type === "radio") return;
      this.#dirty.add(event.target.id);
      this.#say("");
    });
    form.addEventListener("focusin", (event) => { this.#entered = event.target.id; });
    form.addEventListener("focusout", () => { this.#entered = null; this.showSettings(); });
    form.addEventListener("change", (event) => { if (event.target.name === "state") this.#setState(event.target.value); });
    form.addEventListener("submit", (event) => { event.preventDefault(); this.#apply(); });
    byId("reset").addEventListener("click", () => { this.#dirty.clear(); this.#send({ sensor: this.chosen, reset: true }); });
  }

  /** Another scene: rows anew, and the first sensor chosen unless the one before is there too. */
  newScene() {
    const sensors = this.picture.news.scene?.sensors ?? [];
    this.#rows.clear();
    byId("sensors").replaceChildren(...sensors.map((sensor, number) => this.#row(sensor, number)));
    const kept = sensors.some((sensor) => sensor.id === this.chosen);
    this.choose(kept ? this.chosen : (sensors[0]?.id ?? null));
  }

  #row(sensor, number) {
    const row = element("tr");
    row.innerHTML = '<td><input type="checkbox" checked></td><td><button type="button" aria-pressed="false"></button></td><td class="number">0</td><td></td>';
    const box = row.querySelector("input"), button = row.querySelector("button");
    box.setAttribute("aria-label", `Show ${sensor.id}`);
    box.checked = !this.hidden.has(sensor.id);
    box.addEventListener("change", () => { this.hidden[box.checked ? "delete" : "add"](sensor.id); this.onHide(); });
    button.append(swatch(shapeOf(sensor.type), number % SENSOR_COLOURS), `${sensor.id} · ${sensor.label}`);
    button.addEventListener("click", () => this.choose(sensor.id));
    this.#rows.set(sensor.id, { row, button, rate: row.children[2], state: row.children[3] });
    return row;
  }

  choose(id) {
    this.chosen = id;
    this.#dirty.clear();
    this.#entered = null;
    for (const [key, { row, button }] of this.#rows) {
      row.classList.toggle("chosen", key === id);
      button.setAttribute("aria-pressed", String(key === id));
    }
    this.#say("");
    this.showSettings();
    this.onChoose(id);
  }

  /** Show or hide what a sensor measures. */
  show(id, shown) {
    const box = this.#rows.get(id)?.row.querySelector("input");
    if (box && box.checked !== shown) box.click();
  }

  showRates() {
    const last = this.picture.seconds.at(-1);
    (this.picture.news.scene?.sensors ?? []).forEach((sensor, number) => {
      this.#rows.get(sensor.id).rate.textContent = last ? (last.plots[number] ?? 0) : 0;
    });
  }

  /** What is in force, in the table and beside the fields; fields that are being filled in are left alone. */
  showSettings() {
    for (const sensor of this.picture.news.scene?.sensors ?? []) {
      const state = this.#stateOf(sensor), cell = this.#rows.get(sensor.id)?.state;
      if (cell) Object.assign(cell, { textContent: state, className: `state-${state}` });
    }
    const sensor = this.#sensor();
    byId("sensor-title").textContent = sensor ? `${sensor.id}: settings` : "Sensor";
    byId("sensor-form").inert = !sensor || "sensor" in refusals(this.picture.news);
    this.showPointing();
    if (!sensor) return;
    const now = this.#inForce(sensor), link = now.link ?? {}, loss = askedLoss(link.loss);
    if (!this.#asking) for (const radio of document.querySelectorAll("input[name=state]")) radio.checked = radio.value === this.#choiceOf(sensor);
    const pfa = now.pfa ?? sensor.pfa;
    byId("pfa").disabled = sensor.pfa == null;
    this.#show("pfa", pfa == null ? "" : power(pfa), pfa == null ? "has none" : power(pfa));
    this.#show("latency", link.latency_ms ?? 0, `${plain(link.latency_ms ?? 0)} ms`);
    this.#show("jitter", link.jitter_ms ?? 0, `${plain(link.jitter_ms ?? 0)} ms${link.distribution ? ` ${link.distribution}` : ""}`);
    this.#show("loss", loss.share == null ? "" : +(100 * loss.share).toPrecision(6), loss.share == null ? link.loss.kind : `${plain(100 * loss.share)} %`);
    this.#show("burst", loss.burst == null ? 1 : +loss.burst.toPrecision(6), link.loss ? plain(loss.burst) : "–");
  }

  /** What the chosen sensor is, and where it points if it turns. */
  showPointing() {
    const sensor = this.#sensor(), { pointing } = this.picture.news, words = byId("sensor-words");
    const told = [sensor?.preset && `Preset ${sensor.preset}.`, pointingWords(pointing?.[sensor?.id])].filter(Boolean).join(" ");
    words.hidden = !told;
    if (words.textContent !== told) words.textContent = told;
  }

  #show(id, value, words) {
    if (!this.#dirty.has(id) && this.#entered !== id) byId(id).value = value;
    byId(`${id}-now`).textContent = words;
  }

  #sensor() {
    return this.picture.news.scene?.sensors.find((sensor) => sensor.id === this.chosen);
  }

  #inForce(sensor) {
    return this.picture.news.settings?.[sensor.id] ?? {};
  }

  #stateOf(sensor) {
    const now = this.#inForce(sensor);
    if (now.enabled === false) return "off";
    if (now.link?.down) return "link down";
    const worse = (key) => sensor[key] != null && now[key] != null && now[key] > sensor[key] * 1.0001;
    return worse("pfa") || worse("loss_db") ? "degraded" : "on";
  }

  /** Which of the three states that can be chosen it has; none where it is worse by something else. */
  #choiceOf(sensor) {
    const now = { ...sensor, ...this.#inForce(sensor) };
    if (now.enabled === false) return "off";
    const like = (degraded) => Object.entries(worsened(sensor, degraded)).every(([key, value]) => Math.abs(now[key] - value) <= 1e-6 * Math.abs(value));
    return like(false) ? "on" : like(true) ? "degraded" : "";
  }

  #setState(state) {
    const set = { enabled: state !== "off", ...(state === "off" ? {} : worsened(this.#sensor(), state === "degraded")) };
    this.#send({ sensor: this.chosen, set });
  }

  /** What was filled in, and nothing else. */
  #apply() {
    const set = {}, link = {}, dirty = this.#dirty;
    const number = (id) => (byId(id).value.trim() === "" ? null : Number(byId(id).value));
    const garbled = [...dirty].find((id) => byId(id).validity.badInput || Number.isNaN(number(id)));
    if (garbled) {
      const field = byId(garbled), word = document.querySelector(`label[for=${garbled}]`).textContent;
      this.#say(`${word}: a number such as ${EXAMPLES[garbled]} is expected${field.value ? `, not ${JSON.stringify(field.value)}` : ""}.`, true);
      field.focus();
      return;
    }
    if (dirty.has("pfa")) set.pfa = number("pfa");
    if (dirty.has("latency")) link.latency_ms = number("latency");
    if (dirty.has("jitter")) link.jitter_ms = number("jitter");
    const bursty = dirty.has("burst") || this.#inForce(this.#sensor()).link?.loss?.kind === "gilbert-elliott"; // else it is shown, not asked for
    if (dirty.has("loss") || dirty.has("burst")) link.loss = lossOf(number("loss"), bursty ? number("burst") : null);
    if (Object.keys(link).length) set.link = link;
    if (!Object.keys(set).length) {
      this.#say("Nothing was changed.");
      return;
    }
    this.#send({ sensor: this.chosen, set }, new Map([...dirty].map((id) => [id, byId(id).value])));
  }

  async #send(command, filled = new Map()) {
    this.#asking++;
    this.#say("Asking…");
    const answer = await this.ask(command);
    this.#asking--;
    if (answer.in_force) this.picture.news.settings = { ...this.picture.news.settings, [command.sensor]: answer.in_force };
    if (command.sensor !== this.chosen) return;
    // What was filled in while the answer was on its way has not been asked for yet.
    if (answer.ok) for (const [id, value] of filled) if (byId(id).value === value) this.#dirty.delete(id);
    this.#say(answer.ok ? "In force." : answer.error, !answer.ok);
    this.showSettings();
  }

  #say(words, failed = false) {
    sayAnswer("answer", { ok: !failed, error: words }, words);
  }
}

/** The keys of a sensor that is degraded, or as in the scene. */
function worsened({ pfa, loss_db: loss }, degraded) {
  const keys = {};
  if (pfa != null) keys.pfa = degraded ? Math.min(+(pfa * DEGRADED_PFA).toPrecision(9), 0.1) : pfa;
  if (loss != null) keys.loss_db = degraded ? loss + DEGRADED_LOSS_DB : loss;
  return keys;
}

/** The keys of a link's loss, for a percentage and a mean burst; each message by itself where that loses them in bursts as long. */
function lossOf(percent, burst) {
  if (!percent) return null;
  const share = +(percent / 100).toPrecision(12);
  return burst > 1 / (1 - share) ? { kind: "gilbert-elliott", mean_loss: share, mean_burst: burst } : { kind: "random", probability: share };
}
