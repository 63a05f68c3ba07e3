// What all parts of the page use: elements, what this browser keeps, a line, a number in words.

export const byId = (id) => document.getElementById(id);

/** A new element with those words, and what else is given of it. */
export function element(tag, words = "", more = {}) {
  return Object.assign(document.createElement(tag), { textContent: words }, more);
}

/** What this browser has kept by that name; null for nothing, or where a browser keeps nothing. */
export function kept(name) {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

export function keep(name, words) {
  try {
    localStorage.setItem(name, words);
  } catch { /* a browser that keeps nothing */ }
}

/** A straight line in the context's colour, width and dashes. */
export function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

export function drawCross(context, x, y, arm) {
  line(context, x - arm, y - arm, x + arm, y + arm);
  line(context, x + arm, y - arm, x - arm, y + arm);
}

/** Say in an element what became of something that was asked for, in the error's words if it failed. */
export function sayAnswer(id, { ok, error }, fine = "") {
  byId(id).textContent = ok ? fine : error;
  byId(id).toggleAttribute("data-failed", !ok);
}

/** Seconds as minutes and seconds: 1:02.5. */
export const clockText = (seconds) => `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;

/** The time of day of milliseconds of UTC, to so many decimals of a second. */
export const clock = (ms, decimals = 0) => new Date(ms).toISOString().slice(11, decimals ? 20 + decimals : 19);

export const fixed = (value, digits, unit) => (Number.isFinite(value) ? `${value.toFixed(digits)}${unit}` : "–");
