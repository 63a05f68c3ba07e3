// Keys that work wherever one is on the page, but not while something is typed; and the help, which tells of
// them and of what there is to see in the scene.

import { byId, element } from "./common.js";

const TYPING = "input:not([type=checkbox]):not([type=radio]):not([type=range]):not([type=button]), textarea, select, [contenteditable]";
const MOVED_BY_ARROWS = "input[type=range], input[type=radio], select, [role=region], [data-arrows]";
const PRESSED_BY_SPACE = "button, a, summary, input";

/** Hear keys: what is said of each, and what it does, {key: [words, does]}. */
export function hearKeys(keys) {
  addEventListener("keydown", (event) => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, { target } = event;
    if (!keys[key] || event.defaultPrevented || event.ctrlKey || event.altKey || event.metaKey) return;
    if (target.closest?.(TYPING) || (key.startsWith("Arrow") && target.closest?.(MOVED_BY_ARROWS))) return;
    if (key === " " && target.closest?.(PRESSED_BY_SPACE)) return;
    event.preventDefault();
    keys[key][1]();
  });
}

const NAMES = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", " ": "Space", Escape: "Esc", "-": "−" };

/** What is said of keys, {key: [words, …]}, those with the same words together. */
export function showKeys(keys) {
  const byWords = new Map();
  for (const [key, [words]] of Object.entries(keys)) {
    if (words) byWords.set(words, [...(byWords.get(words) ?? []), NAMES[key] ?? key.toUpperCase()]);
  }
  byId("keys").replaceChildren(...[...byWords].map(([words, names]) => {
    const row = element("tr"), first = element("td");
    first.append(...names.flatMap((name) => [element("kbd", name), " "]));
    row.append(first, element("td", words));
    return row;
  }));
  byId("keys-text").textContent = [...byWords].map(([words, names]) => `${names.join(" ")}: ${words}.`).join(" ");
}

/** What a scene says of itself: {words, look_for}. */
export function showAbout({ words, look_for: lookFor = [] } = {}) {
  const list = element("ul");
  list.append(...lookFor.map((line) => element("li", line)));
  byId("about").replaceChildren(...(words ? [element("p", words)] : []), ...(lookFor.length ? [element("h3", "What to look for"), list] : []));
}
