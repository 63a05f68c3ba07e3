// The session as a whole: its clock, recording and replay, the choice of scenes, totals and refusals.

import { byId, clock, clockText, element, sayAnswer } from "./common.js";
import { refusals } from "./roles.js";

const TOTALS = [
  ["drones", "Drones"], ["forgotten", "Forgotten"], ["looks", "Looks"], ["plots", "Plots"], ["false_alarms", "False alarms"], ["messages", "Messages"],
  ["lost", "Lost"], ["duplicated", "Duplicated"], ["undelivered", "Undelivered"], ["missed_scans", "Missed scans"], ["telemetry", "Telemetry"], ["refused", "Refused"], ["stale", "Too late"],
  ["flooded", "Flooded"], ["late", "Late"], ["conflated", "Conflated"], ["intake_behind_s", "Behind, s"],
];
const SURE_MS = 10_000;
const whole = new Intl.NumberFormat("en");

export class Session {
  constructor(picture, ask) {
    this.picture = picture;
    this.ask = ask;
    this.#hear("pause", () => ({ clock: { paused: !this.#state.clock?.paused } }));
    this.#hear("step", () => ({ clock: { step_s: 1 } }));
    this.#hear("restart", () => ({ session: { restart: true } }), true);
    this.#hear("record", () => ({ record: this.#state.record?.on ? { stop: true } : { start: true } }));
    this.#hear("load-scene", () => ({ session: { scene: byId("scene").value } }), true);
    this.#hear("load-recording", () => ({ replay: { load: byId("recording").value } }), true);
    byId("speed").addEventListener("change", () => this.send({ clock: { speed: Number(byId("speed").value) } }));
    byId("totals").replaceChildren(...TOTALS.flatMap(([key, words]) => [element("dt", words), element("dd", "0", { id: `total-${key}` })]));
  }

  get #state() {
    return this.picture.news.session ?? {};
  }

  /** What ends the session, and with it a recording that runs, is said first, and done when it is pressed again. */
  #hear(id, command, ends = false) {
    let saidAt = -Infinity;
    byId(id).addEventListener("click", () => {
      if (ends && this.#state.record?.on && performance.now() - saidAt > SURE_MS) {
        saidAt = performance.now();
        sayAnswer("session-answer", { ok: true }, `This ends the recording to ${this.#state.record.file}: press ${byId(id).textContent} again.`);
        return;
      }
      saidAt = -Infinity;
      this.send(command());
    });
  }

  /** Ask for something, and say why not if it is refused. */
  async send(command) {
    if (command.replay?.load) sayAnswer("session-answer", { ok: true }, "Looking through the recording");
    const answer = await this.ask(command);
    sayAnswer("session-answer", answer);
    if (!answer.ok) this.show();
  }

  show() {
    const { news } = this.picture, { clock = {}, record = {}, replay = {}, scenes = [], recordings = [], notes = [] } = this.#state, refuses = refusals(news);
    byId("scene-name").textContent = news.scene?.name ?? "";
    document.title = news.scene ? `${news.scene.name} · plotfeed` : "plotfeed";
    for (const part of document.querySelectorAll("[data-needs]")) {
      const need = part.dataset.needs;
      part.title = refuses[need] ?? "";
      part.disabled = need in refuses || (need === "scene" && !scenes.length) || (need === "replay" && !recordings.length);
    }
    byId("pause").textContent = clock.paused ? "Go on" : "Pause";
    byId("pause").setAttribute("aria-pressed", String(Boolean(clock.paused)));
    showSpeed(clock.speed ?? 1);
    byId("record").setAttribute("aria-pressed", String(Boolean(record.on)));
    byId("record-text").textContent = record.on ? `Stop ${clockText(record.seconds ?? 0)}` : "Record";
    fill("scene", scenes, news.scene?.name);
    fill("recording", recordings, replay.file);
    const recorded = record.file && !refuses.record ? [`${record.on ? "Recording to" : "Recorded"} ${record.file}.`] : [];
    byId("not-allowed").textContent = [...new Set([...recorded, ...notes, ...Object.values(refuses)])].join(" ");
  }

  showTotals() {
    const told = this.picture.news.totals ?? {}, none = Object.keys(told).length ? {} : Object.fromEntries(TOTALS.map(([key]) => [key, 0])), totals = { ...none, ...told };
    byId("reached").textContent = told.speed_reached < 0.98 * told.speed ? `reaches × ${Number(told.speed_reached.toPrecision(2))}` : "";
    for (const [key] of TOTALS) byId(`total-${key}`).textContent = totals[key] == null ? "–" : whole.format(totals[key]);
  }

  showRefusal() {
    const { refusal, track_problem: problem } = this.picture.news, words = byId("refusal");
    words.textContent = [refusal && `Last refused: ${refusal}`, problem && `Tracks: ${problem}`].filter(Boolean).join(" ") || "No telemetry was refused.";
  }

  showTime(nowMs) {
    if (nowMs) byId("time").textContent = clock(nowMs, 1);
  }
}

function showSpeed(speed) {
  const select = byId("speed"), value = String(speed);
  if (![...select.options].some((option) => option.value === value)) select.add(new Option(`× ${value}`, value));
  if (document.activeElement !== select) select.value = value;
}

/** Options by name; the choice that somebody made stays. */
function fill(id, names, current) {
  const select = byId(id);
  if ([...select.options].map((option) => option.value).join("\n") === names.join("\n")) return;
  const before = select.value;
  select.replaceChildren(...names.map((name) => new Option(name, name)));
  select.value = names.includes(before) ? before : names.includes(current) ? current : (names[0] ?? "");
}
