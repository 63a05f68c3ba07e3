// How the parts of a fleet do, where the page is a fleet's.

import { byId, element } from "./common.js";

/** Show what is told of a fleet. */
export function showFleet({ parts, takeovers, gaps, last_gaps: lastGaps }) {
  byId("fleet-text").textContent = `Parts ${parts.length}, take-overs ${takeovers}, gaps ${gaps}`;
  byId("fleet-rows").replaceChildren(...parts.map(row));
  byId("fleet-gaps").replaceChildren(...lastGaps.map((words) => element("li", words)));
}

function row({ part, claim, sensors, state, worker, age_s: age, lateness_p99_us: late }) {
  const of = sensors.length > 3 ? `${sensors.slice(0, 2).join(", ")} and ${sensors.length - 2} more` : sensors.join(", ");
  const made = element("li"), news = age === null ? "no news yet" : `heard ${age.toFixed(1)} s ago, late by ${(late / 1e3).toFixed(2)} ms (p99)`;
  made.append(element("strong", `${part}.${claim} ${state}`), ` ${worker || "nobody"}: ${of}; ${news}`);
  made.title = sensors.join(", ");
  return made;
}
