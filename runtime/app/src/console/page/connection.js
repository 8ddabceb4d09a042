// The WebSocket to the run: one, which comes back by itself.

import { SCENE } from "./scene_file.js";

const RETRY_MS = [250, 500, 1000, 2000, 3000];

// Of a page the run takes 400 messages a second, and has 8 on their way to it: 125 of hands leave room for so many acknowledgements.
const ACKNOWLEDGE_MS = 25;
const UNACKNOWLEDGED_MAX = 6;

export class Connection {
  #socket = null;
  #tries = 0;
  #over = false;
  #seen = 0;
  #acknowledged = -Infinity;
  #heard = 0;

  /** `on.text(message)`, `on.picture(view, seconds, blob)`, `on.places(buffer, seconds)`, `on.open()`, `on.change(link)` with open, lost or over. */
  constructor(on) {
    this.on = on;
    this.#connect();
  }

  /** Milliseconds since something was last heard; none before the first message. */
  get age() {
    return this.#heard ? performance.now() - this.#heard : null;
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.#socket.send(JSON.stringify(message));
  }

  #connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#tries = 0;
      this.#seen = 0;
      this.on.open();
      this.on.change("open");
    };
    socket.onmessage = (event) => this.#message(event.data);
    socket.onclose = (event) => {
      if (this.#socket !== socket) return;
      if (event.code === 1000) this.#over = true;
      this.on.change(this.#over ? "over" : "lost", event.reason);
      if (this.#over) return;
      const wait = RETRY_MS[Math.min(this.#tries++, RETRY_MS.length - 1)];
      setTimeout(() => this.#connect(), wait);
    };
  }

  #message(data) {
    this.#heard = performance.now();
    let counted = true;
    try {
      counted = this.#tell(data);
    } finally {
      // What can't be drawn has arrived all the same.
      if (counted) this.#acknowledge();
    }
  }

  /** Hands a message on; whether it counts among those that are acknowledged. */
  #tell(data) {
    if (typeof data === "string") {
      const message = JSON.parse(data);
      this.on.text(message);
      if (message.kind === "end") this.#over = true;
      return message.kind !== "answer" && message.kind !== "problem" && message.kind !== "end";
    } else {
      const head = new DataView(data, 0, 16);
      if (head.getUint8(0) === SCENE) {
        this.on.places(data, head.getFloat64(8, true));
        return true;
      }
      const image = new Uint8Array(data, 16);
      const type = image[0] === 0xff ? "image/jpeg" : "image/png";
      this.on.picture(head.getUint8(0), head.getUint8(1), head.getFloat64(8, true), new Blob([image], { type }));
      return true;
    }
  }

  // The run sends no more than a few messages ahead of this.
  #acknowledge() {
    this.#seen += 1;
    const now = performance.now();
    if (this.#seen < 2 || (this.#seen < UNACKNOWLEDGED_MAX && now - this.#acknowledged < ACKNOWLEDGE_MS)) return;
    this.send({ seen: this.#seen });
    this.#seen = 0;
    this.#acknowledged = now;
  }
}
