// A clip of what is seen on the display, as a file of this browser: WebM, from one press to the next.

const FRAMES_PER_S = 15;
const LONGEST_MS = 120_000;
const KINDS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm", "video/mp4"];
const byId = (id) => document.getElementById(id);

export class Clip {
  #recorder = null;
  #limit = 0;
  octets = 0; // of the clip that is being recorded

  /** name() gives the beginning of the file's name. */
  constructor(name) {
    this.name = name;
    const kind = globalThis.MediaRecorder && KINDS.find((each) => MediaRecorder.isTypeSupported(each));
    byId("clip").disabled = !kind;
    if (!kind) byId("clip").title = "This browser records no clips.";
    byId("clip").addEventListener("click", () => (this.#recorder ? this.stop() : this.#start(kind)));
  }

  toggle() {
    if (!byId("clip").disabled) byId("clip").click();
  }

  #start(kind) {
    this.octets = 0;
    const chunks = [], stream = byId("screen").captureStream(FRAMES_PER_S);
    this.#recorder = new MediaRecorder(stream, { mimeType: kind });
    this.#recorder.ondataavailable = ({ data }) => {
      this.octets += data.size;
      if (data.size) chunks.push(data);
    };
    this.#recorder.onstop = () => {
      for (const track of stream.getTracks()) track.stop();
      save(new Blob(chunks, { type: kind }), `${this.name()}.${kind.startsWith("video/mp4") ? "mp4" : "webm"}`);
    };
    this.#recorder.start(1000);
    this.#limit = setTimeout(() => this.stop(), LONGEST_MS);
    this.#show();
  }

  stop() {
    clearTimeout(this.#limit);
    this.#recorder?.stop();
    this.#recorder = null;
    this.#show();
  }

  #show() {
    byId("clip").setAttribute("aria-pressed", String(this.#recorder !== null));
    byId("clip").textContent = this.#recorder ? "Save clip" : "Clip";
  }
}

/** Have the browser keep that as a file. */
function save(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
