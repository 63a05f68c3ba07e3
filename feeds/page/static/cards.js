// Cards: parts of the page that are folded to their heads, and unfolded. What is marked data-card and begins
// with a heading is one; this browser keeps which are open. One that is marked data-away too goes altogether
// when it is closed, and a button elsewhere opens it.

import { keep, kept } from "./common.js";

const KEPT = "plotfeed-open-cards";

export class Cards {
  #cards = new Map(); // elements by name
  #asked = read(); // by name, whether somebody here has opened or closed it

  /** onChange() is told when room was made or taken. */
  constructor(onChange) {
    this.onChange = onChange;
    for (const card of document.querySelectorAll("[data-card]")) {
      const name = card.dataset.card;
      this.#cards.set(name, card);
      card.querySelector("h2 button").addEventListener("click", () => this.show(name, !this.isOpen(name)));
      this.#open(card, this.#asked[name] ?? !card.classList.contains("folded"));
    }
  }

  isOpen(name) {
    return !this.#cards.get(name).classList.contains("folded");
  }

  /** Open or close it. */
  show(name, open = true) {
    const card = this.#cards.get(name);
    this.#asked[name] = open;
    keep(KEPT, JSON.stringify(this.#asked));
    this.#open(card, open);
    if (open) card.scrollIntoView({ block: "nearest" });
    this.onChange();
  }

  /** Have a card there for which there was nothing to show before. */
  offer(name) {
    const card = this.#cards.get(name);
    if (!card.hidden) return;
    card.hidden = false;
    this.onChange();
  }

  #open(card, open) {
    card.classList.toggle("folded", !open);
    card.querySelector("h2 button").setAttribute("aria-expanded", String(open));
  }
}

function read() {
  try {
    return JSON.parse(kept(KEPT)) ?? {};
  } catch {
    return {};
  }
}
