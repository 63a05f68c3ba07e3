// The strips below the display: rates, latency, loss, detections, lateness.

import { Chart } from "./chart.js";
import { colours, faded, sensorColour } from "./colours.js";
import { byId } from "./common.js";
import { nice } from "./ground.js";
import { MARK_COLOURS, storiesOf } from "./stories.js";

const OFF = "; NOT as asked";
const HISTORY_S = 120;
const LEAST_LOOKS = 3; // in a bin of range
const FAR_OUT = 3; // times what 95 % of the seconds stay below
const LEAST_SECONDS = 10;
const say = (id, words) => { byId(id).textContent = words; };
const sum = (numbers) => numbers.reduce((a, b) => a + b, 0);
const short = (value) => (Math.abs(value) >= 1000 ? `${+(value / 1000).toPrecision(3)}k` : `${+value.toPrecision(3)}`);

/** Decimals of a mean whose spread is that: two digits of the spread, three decimals at most. */
const digitsBeside = (sigma) => (sigma > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 3) : 1);

/** The top of an axis: seconds that stand far out of the others are cut off there, and marked. */
function topOf(values) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b), usual = sorted[Math.floor(0.95 * (sorted.length - 1))] ?? 0;
  const most = sorted.at(-1) ?? 0;
  return most > FAR_OUT * usual && sorted.length >= LEAST_SECONDS ? FAR_OUT * usual : most;
}

export class Strips {
  #plots = new Chart("plots-strip");
  #latency = new Chart("latency-strip");
  #loss = new Chart("loss-strip");
  #pd = new Chart("pd-strip");
  #late = new Chart("late-strip");

  draw(picture, chosen) {
    const { seconds, news } = picture, sensors = news.scene?.sensors ?? [];
    const number = sensors.findIndex((sensor) => sensor.id === chosen);
    const details = news.details?.[chosen], colour = number < 0 ? colours.accent : sensorColour(number);
    this.#drawPlots(seconds, number, colour, chosen);
    this.#drawLatency(details?.link, colour);
    this.#drawLoss(seconds, details?.link, news.settings?.[chosen]?.link);
    this.#drawDetections(details?.detections, colour);
    this.#drawLateness(seconds);
    this.#mark(seconds, news, chosen);
  }

  /** What was changed: flags where time is an axis, and over the others the stories that the sensor is in. */
  #mark(seconds, news, chosen) {
    const marks = (news.marks ?? []).map((mark) => ({ ...mark, ago: secondsAgo(seconds, mark.t_utc_ms) })).filter(({ ago }) => ago !== null);
    for (const chart of [this.#plots, this.#loss, this.#late]) {
      for (const { kind, ago } of marks) chart.flag(-ago, colours[MARK_COLOURS[kind]]);
      chart.tell(marks.map(({ words, ago }) => `${words}, ${ago} s ago`));
    }
    const stories = storiesOf(news, chosen);
    for (const chart of [this.#latency, this.#pd]) {
      if (stories.length) chart.note(stories.join(", "), colours.warn);
      chart.tell(stories);
    }
  }

  /** A line over the last two minutes. */
  #history(chart, seconds, values, top, options) {
    chart.begin({ low: -HISTORY_S, high: 0, top, unit: "s ago", xStep: 30, xTick: (v) => String(-v), yTick: short, ...options });
    return (of) => seconds.map((second, i) => [i - seconds.length + 1, of(second)]);
  }

  #drawPlots(seconds, number, colour, chosen) {
    const all = seconds.map((s) => sum(s.plots));
    const points = this.#history(this.#plots, seconds, all, nice(Math.max(...all, 4) * 1.05));
    this.#plots.line(points((s) => sum(s.plots)), colours.ink);
    if (number >= 0) this.#plots.line(points((s) => s.plots[number] ?? 0), colour);
    const last = seconds.at(-1);
    const own = number >= 0 && last ? `, ${chosen} ${last.plots[number] ?? 0}` : "";
    say("plots-text", last ? `${sum(last.plots)} /s${own}` : "–");
  }

  #drawLatency(link, colour) {
    const { low_ms: low = 0, width_ms: width = 1, delivered = [], asked = [] } = link ?? {}, bins = Math.max(delivered.length, asked.length, 1);
    const top = Math.max(...delivered, ...asked, 0.02) * 1.1;
    this.#latency.begin({ low, high: low + width * bins, top, unit: "ms", xTick: short, yTick: (v) => `${+(v * 100).toPrecision(3)}%` });
    this.#latency.bars(low, width, delivered, faded(colour, 0.65));
    const steps = asked.flatMap((share, i) => [[low + i * width, share], [low + (i + 1) * width, share]]);
    this.#latency.line(steps, colours.ink);
    if (!delivered.length) this.#latency.say("no message yet");
    const digits = digitsBeside(link?.sigma_ms ?? 1), asks = link?.asked_mean_ms == null ? "" : `asked ${link.asked_mean_ms.toFixed(digits)}, `;
    say("latency-text", link?.mean_ms == null ? "–" : `${asks}is ${link.mean_ms.toFixed(digits)} ± ${link.sigma_ms.toFixed(digits)} ms`);
  }

  #drawLoss(seconds, link, settings) {
    const share = (s) => (s.lost + s.messages ? (100 * s.lost) / (s.lost + s.messages) : null);
    const asked = askedLoss(settings?.loss), most = Math.max(...seconds.map((s) => share(s) ?? 0), (asked.share ?? 0) * 150, 1);
    const points = this.#history(this.#loss, seconds, [], Math.min(nice(most * 1.05), 100), { yTick: (v) => `${+v.toPrecision(3)}%` });
    if (asked.share) this.#loss.line([[-HISTORY_S, 100 * asked.share], [0, 100 * asked.share]], colours.ink, { dashed: true, width: 1 });
    this.#loss.line(points(share), colours.bad);
    if (!link?.messages) { say("loss-text", "–"); return; }
    const asks = asked.share == null ? "" : `asked ${short(100 * asked.share)}%, `;
    const burst = link.mean_burst ? `; burst ${asked.burst ? `${short(asked.burst)}, ` : ""}${link.mean_burst.toFixed(1)}` : "";
    say("loss-text", `${asks}is ${((100 * link.lost) / link.messages).toFixed(1)}%${burst}${link.loss_off ? OFF : ""}`);
  }

  #drawDetections(found, colour) {
    const width = (found?.width_m ?? 400) / 1000, bins = found?.looks.length ?? 25;
    this.#pd.begin({ low: 0, high: width * bins, top: 1.04, unit: "km", xTick: short, yTick: (v) => v.toFixed(1) });
    const used = (found?.looks ?? []).map((n, i) => [n, i]).filter(([n]) => n >= LEAST_LOOKS);
    const middle = (i) => (i + 0.5) * width;
    const curve = (sigmas) => used.map(([n, i]) => [middle(i), Math.min(Math.max((found.expected[i] + sigmas * Math.sqrt(found.variance[i])) / n, 0), 1)]);
    this.#pd.band(curve(-2), curve(2), faded(colours.quiet, 0.22));
    this.#pd.line(curve(0), colours.ink);
    this.#pd.dots(used.map(([n, i]) => [middle(i), found.detected[i] / n, ...wilson(found.detected[i], n)]), colour);
    if (!used.length) this.#pd.say(found === null ? "not for the audience" : "no drone within cover yet");
    const looks = sum(found?.looks ?? []);
    say("pd-text", looks ? `${(sum(found.detected) / looks).toFixed(3)}, predicted ${(sum(found.expected) / looks).toFixed(3)}${found.off ? OFF : ""}` : "–");
  }

  #drawLateness(seconds) {
    const inMs = (us) => (us == null ? NaN : us / 1000), p99 = (s) => inMs(s.late_p99_us);
    const points = this.#history(this.#late, seconds, [], nice(Math.max(topOf(seconds.map(p99)), 0.1) * 1.05));
    this.#late.line(points(p99), colours.warn);
    this.#late.cutOff(points(p99), colours.warn, (ms) => `${short(ms)} ms`);
    this.#late.line(points((s) => inMs(s.late_p50_us)), colours.ink);
    const last = seconds.at(-1);
    say("late-text", !last ? "–" : last.late_p50_us == null ? "no message left" : `p50 ${short(inMs(last.late_p50_us))}, p99 ${short(p99(last))} ms`);
  }
}

/** How many seconds ago something was in the strips; null for what is not in them. */
function secondsAgo(seconds, ms) {
  const i = seconds.findIndex((second) => second.t_utc_ms >= ms);
  if (i < 0) return seconds.length ? 0 : null;
  return i === 0 && ms < seconds[0].t_utc_ms - 2000 ? null : seconds.length - 1 - i;
}

/** The share of messages that a model of loss asks for, and its mean burst; null where no formula is at hand. */
export function askedLoss(loss) {
  if (!loss) return { share: 0, burst: null };
  if (loss.kind === "random") return { share: loss.probability, burst: loss.correlation ? null : 1 / (1 - loss.probability) };
  if (loss.kind !== "gilbert-elliott") return { share: null, burst: null };
  if (loss.mean_loss != null) return { share: loss.mean_loss, burst: loss.mean_burst };
  const good = loss.good_loss ?? 0, bad = loss.bad_loss ?? 1;
  return { share: (loss.p * bad + loss.r * good) / (loss.p + loss.r), burst: good === 0 ? 1 / (1 - bad * (1 - loss.r)) : null };
}

/** An interval of 95 % about a share, after Wilson. */
function wilson(hits, n) {
  const z = 1.96, share = hits / n, spread = z * Math.sqrt((share * (1 - share)) / n + (z * z) / (4 * n * n));
  const middle = share + (z * z) / (2 * n), norm = 1 + (z * z) / n;
  return [Math.max((middle - spread) / norm, 0), Math.min((middle + spread) / norm, 1)];
}
