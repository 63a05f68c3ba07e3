// Thousands of small squares at once: blended into the pixels of the ground by hand, which takes a
// fraction of the time that as many calls of a canvas do.

export class Pixels {
  #ground = null;
  #image = null;
  #pixels = null;
  #width = 0;
  #height = 0;

  /** Begin from what a layer shows: all squares go over that. */
  setGround(context) {
    const { width, height } = context.canvas;
    this.#ground = new Uint32Array(context.getImageData(0, 0, width, height).data.buffer);
    if (width !== this.#width || height !== this.#height) {
      this.#image = context.createImageData(width, height);
      this.#pixels = new Uint32Array(this.#image.data.buffer);
      this.#width = width;
      this.#height = height;
    }
  }

  begin() {
    this.#pixels.set(this.#ground);
  }

  /** A square about a point, in pixels of the device; colour is 0xBBGGRR, opacity a whole number to 256. */
  square(x, y, side, colour, opacity) {
    const left = Math.max(Math.round(x - side / 2), 0), right = Math.min(Math.round(x + side / 2), this.#width);
    const top = Math.max(Math.round(y - side / 2), 0), bottom = Math.min(Math.round(y + side / 2), this.#height);
    const rest = 256 - opacity, pixels = this.#pixels;
    const redBlue = (colour & 0xff00ff) * opacity, green = (colour & 0xff00) * opacity;
    for (let row = top; row < bottom; row++) {
      for (let at = row * this.#width + left, end = row * this.#width + right; at < end; at++) {
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
