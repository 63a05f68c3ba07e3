// Keys that work wherever one is on the page, but not while something is typed, and what they are for.

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
