// How the parts of a fleet do, where the page is a fleet's.

import { byId, element } from "./common.js";

export class FleetCard {
  #told = null;

  /** onFirst() is told of the first news that come. */
  constructor(onFirst) {
    this.onFirst = onFirst;
  }

  /** Take what is told of a fleet; nothing where the page is a session's. */
  take(told) {
    if (!told) return;
    if (!this.#told) this.onFirst();
    this.#told = told;
    byId("fleet-text").textContent = `Parts ${told.parts.length}, take-overs ${told.takeovers}, gaps ${told.gaps}`;
    byId("fleet-rows").replaceChildren(...told.parts.map(row));
    byId("fleet-gaps").replaceChildren(...told.last_gaps.map((words) => element("li", words)));
  }
}

function row({ part, claim, sensors, state, worker, age_s: age, lateness_p99_us: late }) {
  const of = sensors.length > 3 ? `${sensors.slice(0, 2).join(", ")} and ${sensors.length - 2} more` : sensors.join(", ");
  const made = element("li"), news = age === null ? "no news yet" : `heard ${age.toFixed(1)} s ago, late by ${(late / 1e3).toFixed(2)} ms (p99)`;
  made.append(element("strong", `${part}.${claim} ${state}`), ` ${worker || "nobody"}: ${of}; ${news}`);
  made.title = sensors.join(", ");
  return made;
}
