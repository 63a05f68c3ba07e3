// From metres east and north of the site to pixels, and back.

const NEAREST = 0.05; // metres a pixel
const FURTHEST = 20_000;

export class Viewport {
  width = 1;
  height = 1;
  east = 0; // in the middle
  north = 0;
  scale = 10; // metres a pixel

  x(east) {
    return this.width / 2 + (east - this.east) / this.scale;
  }

  y(north) {
    return this.height / 2 - (north - this.north) / this.scale;
  }

  eastAt(x) {
    return this.east + (x - this.width / 2) * this.scale;
  }

  northAt(y) {
    return this.north - (y - this.height / 2) * this.scale;
  }

  /** Nearer by a factor, about a place on the screen that stays where it is. */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const east = this.eastAt(x), north = this.northAt(y);
    this.scale = Math.min(Math.max(this.scale / factor, NEAREST), FURTHEST);
    this.east += east - this.eastAt(x);
    this.north += north - this.northAt(y);
  }

  pan(dx, dy) {
    this.east -= dx * this.scale;
    this.north += dy * this.scale;
  }

  /** Show circles, each {east, north, radius}, whole. */
  fit(circles) {
    const edges = circles.length ? circles : [{ east: 0, north: 0, radius: 5000 }];
    const west = Math.min(...edges.map((c) => c.east - c.radius)), east = Math.max(...edges.map((c) => c.east + c.radius));
    const south = Math.min(...edges.map((c) => c.north - c.radius)), north = Math.max(...edges.map((c) => c.north + c.radius));
    this.east = (west + east) / 2;
    this.north = (south + north) / 2;
    const margin = 34;
    this.scale = Math.max((east - west) / (this.width - 2 * margin), (north - south) / (this.height - 2 * margin), NEAREST);
  }
}

/** The clockwise angle from true north, degrees. */
export function azimuthOf(east, north) {
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}
