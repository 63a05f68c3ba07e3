// Drones, plots and tracks as a plain table: sorted by any column, filtered by words, of bounded length.

import { byId, clock, element } from "./common.js";
import { droneNow, trackNow } from "./marks.js";

const MOST_ROWS = 200;
const MOST_PLOTS = 5000; // the newest, of which rows are made

/** Heading, value to sort by, and digits if it is a number. */
const COLUMNS = {
  plots: [["Time"], ["Sensor"], ["Range, m", 0], ["Azimuth, °", 1], ["Elevation, °", 1], ["Height, m", 0], ["SNR, dB", 1], ["Latency, ms", 0], ["Of"]],
  tracks: [["Track"], ["Azimuth, °", 1], ["Distance, m", 0], ["Speed, m/s", 1], ["Course, °", 0], ["Age, s", 1], ["State"]],
  drones: [["Drone"], ["Azimuth, °", 1], ["Distance, m", 0], ["Above site, m", 0], ["Speed, m/s", 1], ["Course, °", 0], ["State"]],
};
const OF = COLUMNS.plots.length - 1; // whose a plot is: for who sees the truth

export class Tables {
  #sort = { plots: [0, -1], tracks: [0, 1], drones: [0, 1] };
  #drawn = ""; // which head stands there
  #marks = []; // what each row of the table is of

  constructor(display) {
    this.display = display;
    byId("table-of").addEventListener("change", () => this.show());
    byId("table-filter").addEventListener("input", () => this.show());
    byId("table-head").addEventListener("click", ({ target }) => target.closest("button") && this.#sortBy(Number(target.closest("button").dataset.column)));
    byId("table-body").addEventListener("click", ({ target }) => {
      const row = target.closest("button")?.closest("tr");
      if (row) this.display.select(this.#marks[row.sectionRowIndex]);
    });
  }

  get #kind() {
    return byId("table-of").value;
  }

  /** Once a second while it is open, and at once when something about it is chosen. */
  show() {
    const drones = byId("table-of").querySelector("[value=drones]"), { truth } = this.display;
    drones.disabled = !truth;
    drones.textContent = truth ? "Drones" : "Drones: with the truth";
    if (!truth && this.#kind === "drones") byId("table-of").value = "plots";
    if (!byId("table-body").checkVisibility()) return;
    const kind = this.#kind, shown = kind === "plots" && !truth ? OF : COLUMNS[kind].length;
    this.#showHead(kind, shown);
    const words = byId("table-filter").value.toLowerCase().split(/\s+/).filter(Boolean), all = this.#rows(kind);
    const told = all.map((row) => ({ ...row, texts: row.values.slice(0, shown).map((value, i) => textOf(value, COLUMNS[kind][i][1])) }));
    const found = words.length ? told.filter(({ texts }) => words.every((word) => texts.join(" ").toLowerCase().includes(word))) : told;
    const [by, direction] = this.#sort[kind];
    found.sort((a, b) => direction * compared(a.values[by], b.values[by]));
    this.#fill(found.slice(0, MOST_ROWS));
    const cut = found.length > MOST_ROWS ? `the first ${MOST_ROWS} of ${found.length}` : `${found.length}`;
    byId("table-count").textContent = words.length ? `${cut}, of ${all.length}` : cut;
  }

  #sortBy(column) {
    const [by, direction] = this.#sort[this.#kind];
    this.#sort[this.#kind] = [column, by === column ? -direction : 1];
    this.show();
  }

  #showHead(kind, shown) {
    const [by, direction] = this.#sort[kind], head = byId("table-head").rows[0];
    if (this.#drawn !== `${kind} ${shown}`) {
      this.#drawn = `${kind} ${shown}`;
      byId("table-body").replaceChildren();
      head.replaceChildren(...COLUMNS[kind].slice(0, shown).map(([words, digits], i) => {
        const cell = element("th", "", { scope: "col", className: digits === undefined ? "" : "number" });
        const button = element("button", words, { type: "button" });
        button.dataset.column = i;
        cell.append(button);
        return cell;
      }));
    }
    [...head.cells].forEach((cell, i) => {
      if (i === by) cell.setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
      else cell.removeAttribute("aria-sort");
    });
  }

  /** Rows stay where they are and are told anew, so that nobody loses the one that he is at. */
  #fill(rows) {
    const body = byId("table-body");
    while (body.rows.length > rows.length) body.deleteRow(-1);
    this.#marks = rows.map(({ mark }) => mark);
    rows.forEach(({ texts }, i) => {
      const row = body.rows[i] ?? this.#newRow(body, texts.length);
      texts.forEach((words, k) => {
        const cell = k ? row.cells[k] : row.cells[0].firstChild;
        if (cell.textContent !== words) cell.textContent = words;
      });
    });
  }

  #newRow(body, columns) {
    const row = body.insertRow();
    for (let k = 0; k < columns; k++) row.insertCell().className = COLUMNS[this.#kind][k][1] === undefined ? "" : "number";
    row.cells[0].append(element("button", "", { type: "button" }));
    return row;
  }

  #rows(kind) {
    const { picture } = this.display, nowMs = picture.nowMs(performance.now());
    if (kind === "tracks") return [...picture.tracks.values()].map((track) => trackRow(track, nowMs));
    if (kind === "drones") return this.display.truth && picture.drones ? Array.from(picture.drones.drone, (_, i) => droneRow(picture, i, nowMs)) : [];
    return this.#plotRows(picture, nowMs);
  }

  #plotRows({ plots, news, droneNames }, nowMs) {
    const rows = [], { hidden, glowMs, truth } = this.display;
    for (let row = plots.end - 1; row >= plots.begin && rows.length < MOST_PLOTS; row--) {
      const at = plots.at(row), sensor = news.scene?.sensors[plots.sensor[at]];
      if (!sensor || hidden.has(sensor.id) || nowMs - plots.shown_ms[at] >= glowMs || plots.shown_ms[at] > nowMs) continue;
      const of = !truth || plots.drone[at] < -1 ? "" : plots.isFalse(at) ? "false alarm" : (droneNames[plots.drone[at]] ?? "a drone");
      const numbers = ["range_m", "azimuth_deg", "elevation_deg", "height_m", "snr_db", "latency_ms"].map((name) => plots[name][at]);
      rows.push({ mark: { kind: "plot", row, at }, values: [clock(plots.t_utc_ms[at], 1), sensor.id, ...numbers, of] });
    }
    return rows;
  }
}

function trackRow(track, nowMs) {
  const { azimuth, distance, speed, course, age, state } = trackNow(track, nowMs);
  return { mark: { kind: "track", id: track.id }, values: [track.name, azimuth, distance, speed, course, age, state] };
}

function droneRow(picture, i, nowMs) {
  const { number, name, azimuth, distance, up, speed, course, state } = droneNow(picture, i, nowMs);
  return { mark: { kind: "drone", drone: number }, values: [name, azimuth, distance, up, speed, course, state] };
}

function textOf(value, digits) {
  if (digits === undefined) return value;
  return Number.isFinite(value) ? value.toFixed(digits) : "–";
}

/** What is not known comes last, either way; names with numbers in them by those. */
function compared(a, b) {
  if (typeof a === "string") return a.localeCompare(b, "en", { numeric: true });
  if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b);
  return a - b;
}
