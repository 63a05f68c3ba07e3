// The connection to the session: frames in, commands out, and back by itself when it is lost.

import { FEED_PATH } from "./roles.js";

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5000;
const SILENT_MS = 4000; // ten updates a second come, so this is a connection that is dead
const NO_ANSWER = { ok: false, error: "the connection was lost before an answer came" };

export class Feed {
  #socket = null;
  #wait = FIRST_WAIT_MS;
  #waiting = new Map();
  #number = 0;
  #lastHeard = 0;
  #look = null;
  hello = {}; // what the server said first

  /** onFrame(buffer); onState("connecting" | "open" | "lost", words). */
  constructor(onFrame, onState) {
    this.onFrame = onFrame;
    this.onState = onState;
    setInterval(() => this.#checkSilence(), 1000);
    addEventListener("online", () => this.#socket ?? this.#connect());
  }

  start() {
    this.onState("connecting", "Connecting");
    this.#connect();
  }

  /** What this viewer looks at, and who it is: {truth, watch, name}; said again after every reconnection. */
  look(look) {
    this.#look = look;
    this.#say({ look });
  }

  /** The session's answer to a command, whatever happens. */
  ask(command) {
    const number = ++this.#number;
    return new Promise((resolve) => {
      this.#waiting.set(number, resolve);
      if (!this.#say({ number, command })) this.#answered({ number, ...NO_ANSWER });
    });
  }

  #say(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  #connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = (this.#socket = new WebSocket(`${scheme}://${location.host}${FEED_PATH}`));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.#lastHeard = performance.now();
      if (this.#look) this.#say({ look: this.#look });
    };
    socket.onmessage = ({ data }) => this.#heard(data);
    socket.onclose = () => this.#lost(socket);
  }

  #heard(data) {
    this.#lastHeard = performance.now();
    if (typeof data !== "string") {
      this.#wait = FIRST_WAIT_MS;
      this.onState("open", "Connected");
      this.onFrame(data);
      return;
    }
    const message = JSON.parse(data);
    if (message.build) this.#greet(message);
    else if (message.number) this.#answered(message);
  }

  /** The server may have come back with another version of this page. */
  #greet(hello) {
    if (this.hello.build && this.hello.build !== hello.build) location.reload();
    this.hello = hello;
  }

  #answered({ number, ...answer }) {
    this.#waiting.get(number)?.(answer);
    this.#waiting.delete(number);
  }

  #checkSilence() {
    const socket = this.#socket;
    if (socket?.readyState === WebSocket.OPEN && performance.now() - this.#lastHeard > SILENT_MS) {
      socket.onclose = null;
      socket.close();
      this.#lost(socket);
    }
  }

  async #lost(socket) {
    if (socket !== this.#socket) return;
    this.#socket = null;
    for (const number of [...this.#waiting.keys()]) this.#answered({ number, ...NO_ANSWER });
    this.onState("lost", "Connection lost, trying again");
    setTimeout(() => this.#socket ?? this.#connect(), this.#wait);
    this.#wait = Math.min(this.#wait * 2, LONGEST_WAIT_MS);
    const refused = await fetch("/icon.svg", { cache: "no-store" }).then((answer) => answer.status === 403, () => false);
    if (refused && !this.#socket) this.onState("lost", "The address has changed: open the one that plotfeed prints now");
  }
}
