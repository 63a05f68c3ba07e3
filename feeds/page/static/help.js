// The help: what there is to see in the scene, and the keys.

import { byId, element } from "./common.js";

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
