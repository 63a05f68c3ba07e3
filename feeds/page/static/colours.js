// The colours of the theme, read from the style sheet so that they are written once.

import { keep, kept } from "./common.js";

export const SENSOR_COLOURS = 8;
const KEPT = "plotfeed-theme";
const NAMES = ["night", "sea", "panel", "line", "ink", "quiet", "accent", "good", "warn", "bad", "grid", "grid-strong", "map", "map-line", "track", "truth", "gone"];

export const colours = { sensors: [], font: "11px sans-serif" };

/** Read them again, after a change of theme. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
  const body = getComputedStyle(document.body);
  colours.font = `${parseFloat(body.fontSize) - 2}px ${body.fontFamily}`;
  colours.sensors = Array.from({ length: SENSOR_COLOURS }, (_, i) => style.getPropertyValue(`--s${i}`).trim());
}

export function sensorColour(number) {
  return colours.sensors[number % SENSOR_COLOURS];
}

/** The colour with that opacity. */
export function faded(colour, alpha) {
  return colour + Math.round(alpha * 255).toString(16).padStart(2, "0");
}

/** The theme that was chosen, or that the system has. */
export function startTheme() {
  setTheme(kept(KEPT) ?? (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark"));
}

export function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  keep(KEPT, theme);
  readColours();
}
