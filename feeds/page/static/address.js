// What is looked at, in the part of the address after #: kept on reload, and the same for whom it is sent to.
// The truth is never in it: whoever gets such an address asks for that himself.

import { byId } from "./common.js";

const WRITE_EVERY_MS = 500;
const PLACES = { east: 1, north: 1, scale: 4 };

export class Address {
  #written = "";
  #asked = read(); // until there is a scene to show it of

  constructor(display, sensors, trails) {
    Object.assign(this, { display, sensors, trails });
    setInterval(() => this.write(), WRITE_EVERY_MS);
    addEventListener("hashchange", () => {
      if (location.hash === this.#written) return;
      this.#asked = read();
      this.apply();
    });
  }

  /** Show what the address asks for, once. To be called when there is a scene. */
  apply() {
    const asked = this.#asked, { display } = this, listed = (name) => asked.get(name).split(",");
    this.#asked = new URLSearchParams();
    const sensors = display.picture.news.scene?.sensors ?? [];
    if (asked.has("hide")) for (const { id } of sensors) this.sensors.show(id, !listed("hide").includes(id));
    if (asked.has("layers")) for (const layer of Object.keys(display.layers)) tick(`show-${layer}`, listed("layers").includes(layer));
    choose("glow", asked.get("fade"));
    choose("trails", asked.get("trails"));
    if (sensors.some(({ id }) => id === asked.get("sensor"))) this.sensors.choose(asked.get("sensor"));
    const place = (asked.get("at") ?? "").split(",").map(Number);
    if (place.length === 3 && place.every(Number.isFinite) && place[2] > 0) display.lookAt(...place);
  }

  /** Keep what is looked at now in the address, without a step in the browser's history. */
  write() {
    const { display } = this;
    if (!display.picture.news.scene || !display.isFitted) return;
    const told = new URLSearchParams({
      at: Object.entries(PLACES).map(([name, digits]) => +display.view[name].toFixed(digits)).join(","),
      layers: Object.keys(display.layers).filter((layer) => display.layers[layer]).join(","),
      fade: byId("glow").value,
    });
    if (display.hidden.size) told.set("hide", [...display.hidden].join(","));
    if (this.sensors.chosen) told.set("sensor", this.sensors.chosen);
    if (this.trails.lengthMs) told.set("trails", byId("trails").value);
    const hash = `#${told.toString().replaceAll("%2C", ",")}`;
    if (hash === this.#written) return;
    this.#written = hash;
    history.replaceState(null, "", hash);
  }
}

function read() {
  return new URLSearchParams(location.hash.slice(1));
}

function tick(id, on) {
  if (byId(id).checked !== on) byId(id).click();
}

/** Choose that of some options, if it is one. */
function choose(id, value) {
  const select = byId(id);
  if (![...select.options].some((option) => option.value === value)) return;
  select.value = value;
  select.dispatchEvent(new Event("change"));
}
