// Cards: parts of the page that are moved over the picture and back, closed, and opened again. What is marked
// data-card and begins with a heading is one; this browser keeps which are open, and where.

import { byId, element, keep, kept } from "./common.js";

const KEPT = "plotfeed-cards";
const STEP = 24; // pixels that a key moves a card
const MOVES = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, -STEP], ArrowDown: [0, STEP] };
const LEAST_DRAG = 5;
const LEAST_SEEN = 60; // pixels of a card that stay within the window

function button(words, label, kind, onClick) {
  const made = element("button", words, { type: "button", className: kind, title: label });
  made.setAttribute("aria-label", label);
  made.addEventListener("click", onClick);
  return made;
}

export class Cards {
  #cards = new Map(); // by name: element, title, box of the menu, and {closed, left, top} as it is kept

  /** onChange() is told when room was made or taken. */
  constructor(onChange) {
    this.onChange = onChange;
    const before = read();
    for (const part of document.querySelectorAll("[data-card]")) this.#add(part, before[part.dataset.card] ?? {});
    this.#hearMenu();
    addEventListener("resize", () => { for (const card of this.#cards.values()) this.#place(card); });
  }

  isOpen(name) {
    return !this.#cards.get(name).element.hidden;
  }

  /** Open or close it. */
  show(name, shown = true) {
    const card = this.#cards.get(name);
    card.state.closed = !shown;
    card.element.hidden = !shown;
    card.box.checked = shown;
    this.#place(card);
    if (shown) card.element.scrollIntoView({ block: "nearest" });
    this.#changed();
  }

  /** Open it, unless somebody here has closed it. */
  offer(name) {
    const card = this.#cards.get(name);
    if ("closed" in card.state || !card.element.hidden) return;
    card.element.hidden = false;
    card.box.checked = true;
    this.#changed();
  }

  #add(part, state) {
    const name = part.dataset.card, head = part.querySelector("h2"), title = part.dataset.title ?? head.textContent;
    const label = element("label"), box = element("input", "", { type: "checkbox" });
    label.append(box, ` ${title}`);
    byId("cards-list").append(label);
    const card = { element: part, state, box, name };
    this.#cards.set(name, card);
    const tools = element("div", "", { className: "card-tools" });
    card.floater = button("↗", `Move ${name}`, "float", () => this.#float(card, "left" in state ? null : undefined));
    card.floater.addEventListener("keydown", (event) => this.#moveByKey(card, event));
    tools.append(card.floater, button("×", `Close ${name}`, "close", () => { this.show(name, false); byId("cards-button").focus(); }));
    part.append(tools);
    if ("closed" in state) part.hidden = state.closed;
    box.checked = !part.hidden;
    box.addEventListener("change", () => this.show(name, box.checked));
    this.#hearDrag(card, head);
    this.#place(card);
  }

  /** Over the picture at a place, beside where it was without one, or with null back in its column. */
  #float(card, place) {
    const { element, state } = card, was = element.getBoundingClientRect();
    if (place === null) {
      delete state.left;
      delete state.top;
    } else {
      state.width ??= Math.round(was.width);
      [state.left, state.top] = place ?? [Math.max(was.left - was.width - STEP, 0), was.top];
    }
    this.#place(card);
    this.#changed();
  }

  #place({ element, state, floater, name }) {
    const floats = "left" in state;
    element.classList.toggle("floating", floats);
    floater.textContent = floats ? "↙" : "↗";
    floater.title = floats ? "Put it back; arrow keys move it" : "Move it over the picture; arrow keys move it";
    floater.setAttribute("aria-label", `${floats ? "Put back" : "Move"} ${name}`);
    const at = floats ? [Math.min(Math.max(state.left, LEAST_SEEN - state.width), innerWidth - LEAST_SEEN), Math.min(Math.max(state.top, 0), innerHeight - LEAST_SEEN)] : [];
    element.style.left = floats ? `${at[0]}px` : "";
    element.style.top = floats ? `${at[1]}px` : "";
    element.style.width = floats ? `${state.width}px` : "";
  }

  #moveByKey(card, event) {
    const move = MOVES[event.key];
    if (!move) return;
    event.preventDefault();
    const { left, top } = card.element.getBoundingClientRect();
    this.#float(card, [left + move[0], top + move[1]]);
  }

  #hearDrag(card, head) {
    let drag = null;
    head.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || getComputedStyle(card.floater).display === "none") return;
      const { left, top } = card.element.getBoundingClientRect();
      drag = { dx: event.clientX - left, dy: event.clientY - top, x: event.clientX, y: event.clientY, moved: false };
      head.setPointerCapture(event.pointerId);
    });
    head.addEventListener("pointermove", (event) => {
      if (!drag || (!drag.moved && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) < LEAST_DRAG)) return;
      drag.moved = true;
      this.#float(card, [event.clientX - drag.dx, event.clientY - drag.dy]);
    });
    for (const end of ["pointerup", "pointercancel"]) head.addEventListener(end, () => { drag = null; });
  }

  #hearMenu() {
    const opener = byId("cards-button"), list = byId("cards-list");
    const open = (shown) => {
      list.hidden = !shown;
      opener.setAttribute("aria-expanded", String(shown));
    };
    opener.addEventListener("click", () => open(list.hidden));
    addEventListener("pointerdown", (event) => { if (!opener.parentElement.contains(event.target)) open(false); });
    opener.parentElement.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || list.hidden) return;
      open(false);
      opener.focus();
    });
  }

  #changed() {
    keep(KEPT, JSON.stringify(Object.fromEntries([...this.#cards].map(([name, { state }]) => [name, state]))));
    this.onChange();
  }
}

function read() {
  try {
    return JSON.parse(kept(KEPT)) ?? {};
  } catch {
    return {};
  }
}
