// A log's time line: scrub, step, play, jump to what happened.

import { byId } from "./dom.js";

const STEP_S = 0.04;

export class Timeline {
  #send;
  #length = 0;
  #at = 0;
  #sent = -1;
  #step_s = STEP_S;
  #playing = null;
  #events = [];

  constructor(send) {
    this.#send = send;
    byId("at").oninput = () => {
      this.#stop();
      this.go(Number(byId("at").value));
    };
    byId("play").onclick = () => (this.#playing ? this.#stop() : this.#play());
    byId("back").onclick = () => this.#step(-this.#step_s);
    byId("forth").onclick = () => this.#step(this.#step_s);
    document.addEventListener("keydown", (event) => this.#key(event));
  }

  facts(facts) {
    byId("timeline").hidden = !facts.log;
    byId("steering").hidden = facts.log;
    if (!facts.log || facts.episodes) return;
    const { outcome } = facts;
    const verdict = outcome ? (outcome.success === true ? "success" : outcome.success === false ? "failure" : "end") : "no end in the log";
    this.show(facts, `${verdict}${outcome?.reason && outcome.reason !== verdict ? ` (${outcome.reason})` : ""}${outcome?.said ? `; ${outcome.said}` : ""}`);
  }

  /** Goes through so many `seconds` in which these `events` were, a frame at a time if there are `fps`; `ended` says how. */
  show({ seconds: length, events = [], fps }, ended) {
    this.#length = length;
    this.#step_s = fps ? 1 / fps : STEP_S;
    const step = fps ? "one frame" : "40 ms";
    byId("back").setAttribute("aria-label", `Step back ${step}`);
    byId("forth").setAttribute("aria-label", `Step forward ${step}`);
    byId("at").max = String(length);
    byId("log-outcome").textContent = `${length.toFixed(2)} s; ${ended}`;
    byId("events-head").hidden = events.length === 0;
    byId("events").hidden = events.length === 0;
    const marks = [];
    this.#events = events.map(({ seconds, text }) => {
      const item = document.createElement("li");
      const button = document.createElement("button");
      button.type = "button";
      const when = document.createElement("span");
      when.textContent = `${seconds.toFixed(2)} s`;
      const what = document.createElement("span");
      what.textContent = text;
      button.append(when, what);
      button.onclick = () => {
        this.#stop();
        this.go(seconds);
      };
      item.append(button);
      const mark = document.createElement("i");
      mark.style.left = `${(100 * seconds) / Math.max(length, 1e-9)}%`;
      marks.push(mark);
      return { seconds, button, item };
    });
    byId("events").replaceChildren(...this.#events.map(({ item }) => item));
    byId("marks").replaceChildren(...marks);
    this.#sent = -1;
    this.go(this.#at);
  }

  /** From the beginning, at rest. */
  rewind() {
    this.#stop();
    this.#at = 0;
  }

  go(seconds) {
    this.#at = Math.min(this.#length, Math.max(0, seconds));
    byId("at").value = String(this.#at);
    byId("at").setAttribute("aria-valuetext", `${this.#at.toFixed(2)} s`);
    const reached = this.#events.filter((event) => event.seconds <= this.#at + 1e-6);
    const newest = reached.at(-1);
    for (const event of this.#events) event.button.setAttribute("aria-current", String(event === newest));
    if (this.#sent !== this.#at) {
      this.#sent = this.#at;
      this.#send({ at: this.#at });
    }
  }

  #step(by) {
    this.#stop();
    this.go(this.#at + by);
  }

  #play() {
    if (this.#at >= this.#length) this.go(0);
    let before = performance.now();
    byId("play").firstChild.textContent = "Halt ";
    this.#playing = setInterval(() => {
      const now = performance.now();
      this.go(this.#at + ((now - before) / 1000) * Number(byId("rate").value));
      before = now;
      if (this.#at >= this.#length) this.#stop();
    }, 50);
  }

  #stop() {
    clearInterval(this.#playing);
    this.#playing = null;
    byId("play").firstChild.textContent = "Play ";
  }

  #key(event) {
    if (byId("timeline").hidden || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const actions = { ArrowLeft: "back", ArrowRight: "forth" };
    const id = actions[event.key] ?? (event.key === " " && event.target.tagName !== "BUTTON" ? "play" : null);
    if (id) {
      event.preventDefault();
      byId(id).click();
    }
  }
}
