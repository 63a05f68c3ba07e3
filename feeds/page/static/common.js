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

export const fixed = (value, digits, unit) => (Number.isFinite(value) ? `${value.toFixed(digits)}${unit}` : "–");
