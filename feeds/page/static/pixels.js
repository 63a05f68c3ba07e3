// Thousands of small marks at once: blended into the pixels of the ground by hand, which takes a
// fraction of the time that as many calls of a canvas do.

export class Pixels {
  #ground = null;
  #image = null;
  #pixels = null;

  /** Begin from what a layer shows: all squares go over that. */
  setGround(context) {
    const { width, height } = context.canvas;
    this.#ground = new Uint32Array(context.getImageData(0, 0, width, height).data.buffer);
    if (width === this.#image?.width && height === this.#image.height) return;
    this.#image = context.createImageData(width, height);
    this.#pixels = new Uint32Array(this.#image.data.buffer);
  }

  begin() {
    this.#pixels.set(this.#ground);
  }

  /** A stamp of shapes.js about a point, in pixels of the device; colour is 0xBBGGRR, opacity a whole number to 256. */
  stamp(x, y, runs, colour, opacity) {
    const rest = 256 - opacity, pixels = this.#pixels, { width, height } = this.#image;
    const redBlue = (colour & 0xff00ff) * opacity, green = (colour & 0xff00) * opacity;
    const middle = Math.round(x), row = Math.round(y);
    for (let run = 0; run < runs.length; run += 3) {
      const line = row + runs[run];
      if (line < 0 || line >= height) continue;
      const from = Math.max(middle + runs[run + 1], 0), to = Math.min(middle + runs[run + 2], width);
      for (let at = line * width + from, end = line * width + to; at < end; at++) {
        const under = pixels[at];
        pixels[at] = 0xff000000 | ((((under & 0xff00ff) * rest + redBlue) >>> 8) & 0xff00ff) | ((((under & 0xff00) * rest + green) >>> 8) & 0xff00);
      }
    }
  }

  /** Show it on a layer of the same size. */
  put(context) {
    context.putImageData(this.#image, 0, 0);
  }
}

/** #rrggbb as a number with the octets of a pixel. */
export function packed(colour) {
  const value = parseInt(colour.slice(1), 16);
  return ((value & 0xff) << 16) | (value & 0xff00) | (value >> 16);
}
