// Stories: what can happen at a word, by one click, and is taken back by another; and undo.

import { byId, element, sayAnswer } from "./common.js";
import { refusals } from "./roles.js";

export const MARK_COLOURS = { story: "warn", change: "accent", script: "quiet" };

export class Stories {
  #buttons = new Map(); // by story
  #told = "";

  constructor(picture, ask) {
    Object.assign(this, { picture, ask });
    byId("undo").addEventListener("click", () => this.#send({ undo: true }));
  }

  /** Those of the scene, and which are on; told when stories, what undo would undo, or the session changed. */
  show() {
    const { stories = [], undoes = "" } = this.picture.news, refuses = refusals(this.picture.news);
    const told = stories.map(({ id, title, text }) => `${id} ${title} ${text}`).join("\n");
    if (told !== this.#told) this.#renew(stories);
    this.#told = told;
    for (const story of stories) {
      const button = this.#buttons.get(story.id);
      button.setAttribute("aria-pressed", String(story.since_utc_ms !== null));
      button.disabled = "story" in refuses;
      button.title = refuses.story ?? "";
    }
    byId("undo").disabled = !undoes || "undo" in refuses;
    byId("undo-words").textContent = undoes || "Nothing to undo.";
    byId("no-stories").hidden = stories.length > 0;
  }

  #renew(stories) {
    this.#buttons.clear();
    byId("stories").replaceChildren(...stories.map(({ id, title, text }, i) => {
      const story = element("div"), button = element("button", title, { type: "button" });
      story.append(button, element("p", text, { id: `story-${i}` }));
      button.setAttribute("aria-describedby", `story-${i}`);
      button.addEventListener("click", () => this.#send(this.#isOn(id) ? { story: id, reset: true } : { story: id }));
      this.#buttons.set(id, button);
      return story;
    }));
  }

  #isOn(id) {
    return this.picture.news.stories.some((story) => story.id === id && story.since_utc_ms !== null);
  }

  async #send(command) {
    sayAnswer("story-answer", await this.ask(command));
  }
}

/** Titles of the stories that are on and concern a sensor. */
export function storiesOf(news, sensor) {
  return (news.stories ?? []).filter((story) => story.since_utc_ms !== null && story.sensors.includes(sensor)).map((story) => story.title);
}
