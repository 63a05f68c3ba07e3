// Presenter and audience: who this page is, what it may do, what the presenter gives, and who did what.

import { byId, clock, element, keep, kept } from "./common.js";

const KEPT_NAME = "plotfeed-name";
const NO_CONTROLS = "The presenter has not given the audience the controls.";
const NO_TRUTH = "The presenter has not given the audience the truth.";
const CONTROLS = ["pause", "step", "speed", "restart", "record", "scene", "replay", "sensor", "story", "undo"];

export const isAudience = location.pathname.startsWith("/audience");
/** Where this page's WebSocket is. */
export const FEED_PATH = isAudience ? "/audience/feed" : "/feed";

/** Why controls do not work here, by name: what the session says, and what the audience was not given. */
export function refusals(news) {
  const given = !isAudience || news.audience?.controls;
  return { ...(given ? {} : Object.fromEntries(CONTROLS.map((name) => [name, NO_CONTROLS]))), ...news.session?.refuses };
}

export class Roles {
  #asking = false;

  /** ask(command) gives the session's answer; onName() is told of another name, onTruth(may) of the truth; address() gives the audience's. */
  constructor(picture, { ask, onName, onTruth, address }) {
    Object.assign(this, { picture, ask, onName, onTruth, address });
    document.documentElement.dataset.role = isAudience ? "audience" : "presenter";
    byId("role-text").textContent = isAudience ? "You are in the audience: what you may see and do is the presenter's to give." : "Whoever has the audience's address sees what you see, without the truth and without controls, unless you give them.";
    byId("gifts").hidden = isAudience;
    for (const gift of ["truth", "controls"]) {
      byId(`give-${gift}`).addEventListener("change", (event) => this.#give({ [gift]: event.target.checked }));
    }
    byId("who").value = this.name;
    byId("who").addEventListener("change", () => { keep(KEPT_NAME, byId("who").value); this.onName(); });
  }

  get name() {
    return kept(KEPT_NAME) ?? "";
  }

  /** Whether this page may ask for the truth. */
  get maySeeTruth() {
    return !isAudience || Boolean(this.picture.news.audience?.truth);
  }

  async #give(gift) {
    this.#asking = true;
    const answer = await this.ask({ audience: gift });
    this.#asking = false;
    byId("gift-answer").textContent = answer.ok ? "" : answer.error;
    if (answer.ok) this.picture.news.audience = answer.in_force;
    this.show();
  }

  show() {
    const { audience = {}, actions = [] } = this.picture.news;
    if (!this.#asking) for (const gift of ["truth", "controls"]) byId(`give-${gift}`).checked = Boolean(audience[gift]);
    if (!isAudience && this.address()) byId("audience-url").value = audienceAddress(this.address());
    byId("truth").disabled = !this.maySeeTruth;
    byId("truth").title = this.maySeeTruth ? "Drones, false alarms and lost plots: not for a tracker team" : NO_TRUTH;
    byId("actions").replaceChildren(...[...actions].reverse().map(({ t_utc_ms: at, who, what }) => {
      const item = element("li"), time = element("time", clock(at));
      item.append(time, " ", element("b", who), ` ${what}`);
      return item;
    }));
    byId("no-actions").hidden = actions.length > 0;
    this.onTruth(this.maySeeTruth);
  }
}

/** The audience's address, as a browser on another machine can use it. */
function audienceAddress(url) {
  const found = new URL(url);
  found.host = location.host;
  return found.href;
}
