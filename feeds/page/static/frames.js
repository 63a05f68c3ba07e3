// Reads the frames of feeds/page/updates.py: typed arrays laid over the message, nothing copied.

export const Kind = { NEWS: 1, PLOTS: 2, PLOT_TRUTHS: 3, LOST_PLOTS: 4, DRONES: 5, TRACKS: 6, TRUE_NEWS: 7 };
export const PlotFlag = { BEARING: 1, NOWHERE: 2 };
export const TrackFlag = { TENTATIVE: 1, COASTED: 2, ENDED: 4 };
export const FALSE_ALARM = -1;

const MAGIC = 0x31464c50; // "PLF1", read as little-endian
const HEADER_OCTETS = 24;
const SECTION_OCTETS = 16;
const SNAPSHOT = 1;
const ARRAYS = { f8: Float64Array, f4: Float32Array, u4: Uint32Array, i4: Int32Array, u2: Uint16Array, u1: Uint8Array };
const text = new TextDecoder();

/** Knows the layouts of sections from the news that every snapshot begins with. */
export class FrameReader {
  #layouts = {};

  /** {isSnapshot, number, nowMs, sections}; a section has kind and either news or rows, first, columns. */
  read(buffer) {
    const view = new DataView(buffer);
    if (view.getUint32(0, true) !== MAGIC) throw new Error("not a frame of plotfeed");
    const frame = {
      isSnapshot: (view.getUint32(4, true) & SNAPSHOT) !== 0,
      number: Number(view.getBigUint64(8, true)),
      nowMs: view.getFloat64(16, true),
      octets: buffer.byteLength,
      sections: [],
    };
    for (let at = HEADER_OCTETS; at < buffer.byteLength; ) {
      const [kind, rows, first, octets] = new Uint32Array(buffer, at, 4);
      const section = this.#section(buffer, at + SECTION_OCTETS, kind, rows, first);
      if (section) frame.sections.push(section);
      at += SECTION_OCTETS + octets;
    }
    return frame;
  }

  #section(buffer, at, kind, rows, first) {
    if (kind === Kind.NEWS || kind === Kind.TRUE_NEWS) {
      const news = JSON.parse(text.decode(new Uint8Array(buffer, at, rows)));
      if (news.layouts) this.#layouts = news.layouts;
      return { kind, news };
    }
    const layout = this.#layouts[kind];
    if (!layout) return null;
    const columns = {};
    for (const [name, type] of layout) {
      const column = new ARRAYS[type](buffer, at, rows);
      columns[name] = column;
      at += Math.ceil(column.byteLength / 8) * 8;
    }
    return { kind, rows, first, columns };
  }
}
