// How the tracker under test does, and whether the feed is as claimed: for who may see the truth.

import { Chart } from "./chart.js";
import { colours } from "./colours.js";
import { byId, element, fixed } from "./common.js";
import { nice } from "./ground.js";

const HISTORY_S = 120;
const NONE = "Shown with the truth, where the scene has a tracker under test.";
const percent = (share) => (Number.isFinite(share) ? `${(100 * share).toFixed(0)} %` : "–");
const short = (value) => `${+value.toPrecision(3)}`;

const ROWS = [
  ["GOSPA", (s) => fixed(s.gospa_m, 1, " m")],
  ["OSPA", (s) => fixed(s.ospa_m, 1, " m")],
  ["Complete", (s) => percent(s.completeness)],
  ["Spurious", (s) => percent(s.spuriousness)],
  ["Error", (s) => fixed(s.position_error_m, 1, " m")],
  ["Latency", (s) => fixed(s.latency_s, 2, " s")],
];

export class Score {
  #chart = null;
  #past = [];
  #latest = null;

  /** onFirst() is told of the first score that comes. */
  constructor(onFirst) {
    this.onFirst = onFirst;
    byId("score-text").textContent = NONE;
  }

  /** Take a score that came, null where there is none, or none that may be shown. */
  take(score) {
    if (!score) this.#past = [];
    else if (score.time_utc !== this.#latest?.time_utc) {
      if (!this.#latest) this.onFirst();
      if (score.reports) this.#past = [...this.#past, score.now.gospa_m].slice(-HISTORY_S);
    }
    this.#latest = score;
    byId("score-body").hidden = !score;
    byId("score-text").textContent = !score ? NONE : score.reports ? `${score.tracks} tracks, ${score.drones} drones; means of ${score.window_s} s, tracks within ${short(score.cutoff_m)} m` : `No tracks have come on ${score.tracks_topic}: there is no tracker to score.`;
    byId("score-values").hidden = byId("score-strip").hidden = !score?.reports;
    if (score) this.#show(score);
  }

  #show(score) {
    byId("score-values").replaceChildren(...ROWS.flatMap(([name, told]) => [element("dt", name), element("dd", told(score.window))]));
    if (score.reports) this.#draw(score.cutoff_m);
    const wrong = score.feed.filter((check) => check.wrong), judged = score.feed.filter((check) => check.z != null);
    const named = wrong.map(({ sensor, check, found, unit }) => `${sensor}: ${check} ${short(found)} ${unit}`.trim()).join("; ");
    byId("score-feed").textContent = wrong.length ? `Feed differs from its claims: ${named}` : judged.length ? `Feed agrees with its claims: ${judged.length} checks` : "Feed: nothing to judge yet";
    byId("score-problem").textContent = score.unreadable ? `${score.unreadable} reports of tracks left out: ${score.problem}` : "";
  }

  #draw(cutoff) {
    this.#chart ??= new Chart("score-strip");
    const top = nice(Math.max(...this.#past.filter(Number.isFinite), cutoff / 5) * 1.05);
    this.#chart.begin({ low: -HISTORY_S, high: 0, top, unit: "s ago", xStep: 30, xTick: (v) => String(-v), yTick: short });
    this.#chart.line(this.#past.map((value, i) => [i - this.#past.length + 1, value]), colours.track);
  }
}
