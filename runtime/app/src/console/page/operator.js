// The operator's buttons, slider and keys.

import { byId, takesLetters } from "./dom.js";

export class Operator {
  #send;
  #steers = false;
  #taken = false;
  #open = false;
  #dragging = false;
  #mark = null;

  constructor(send) {
    this.#send = send;
    this.buttons = [...document.querySelectorAll("button[data-command]")];
    this.speed = byId("speed");
    for (const button of this.buttons) button.onclick = () => this.command(button.dataset.command);
    byId("steer").onclick = () => this.#send({ steer: !this.#steers });
    this.speed.oninput = () => {
      this.#dragging = true;
      byId("speed-out").textContent = `${this.speed.value} %`;
    };
    this.speed.onchange = () => {
      this.#dragging = false;
      this.command(`speed ${this.speed.value}`);
    };
    this.marks = [...document.querySelectorAll("button[data-mark]")];
    // The mark that is set is taken back.
    for (const button of this.marks) {
      button.onclick = () => this.#send({ mark: button.dataset.mark === this.#mark ? null : button.dataset.mark });
    }
    this.label = byId("mark-label");
    this.label.oninput = () => this.#send({ label: this.label.value });
    this.label.onkeydown = ({ key }) => {
      if (key === "Enter" || key === "Escape") this.label.blur();
    };
    document.addEventListener("keydown", (event) => this.#key(event));
    this.#show();
  }

  command(text) {
    byId("answer").textContent = `${text} …`;
    byId("answer").dataset.ok = "true";
    this.#send({ command: text });
  }

  answer({ command, ok, text }) {
    byId("answer").textContent = `${command}: ${text}`;
    byId("answer").dataset.ok = String(ok);
  }

  problem({ text }) {
    byId("answer").textContent = text;
    byId("answer").dataset.ok = "false";
  }

  seat({ steers, taken, pages }) {
    this.#steers = steers;
    this.#taken = taken;
    const others = pages === 1 ? "no other page" : `${pages - 1} other ${pages === 2 ? "page" : "pages"}`;
    const who = steers ? "This page steers" : taken ? "Another page steers" : "Nobody steers";
    byId("seat").textContent = `${who}; ${others}.`;
    this.#show();
  }

  link(open) {
    this.#open = open;
    if (!open) {
      this.#steers = false;
      byId("seat").textContent = "";
    }
    this.#show();
  }

  setSpeed(percent) {
    if (this.#dragging || document.activeElement === this.speed && this.#steers) return;
    this.speed.value = percent;
    byId("speed-out").textContent = `${percent} %`;
  }

  /** What is said of a run that nothing judges; nothing of one that does not ask. */
  said(said) {
    byId("mark").hidden = !said;
    if (!said) return;
    this.#mark = said.mark;
    for (const button of this.marks) button.setAttribute("aria-pressed", String(button.dataset.mark === said.mark));
    const marked = said.mark ? `Marked ${said.mark}; Stop run ends the run.` : "How does the run go? The log keeps the last mark.";
    const state = byId("mark-state");
    if (state.textContent !== marked) state.textContent = marked;
    if (document.activeElement !== this.label && this.label.value !== said.label) this.label.value = said.label;
  }

  #show() {
    const able = this.#open && this.#steers;
    // Pause and stop bring the arms to rest: any page may.
    const rests = ({ dataset }) => dataset.command === "pause" || dataset.command === "stop";
    for (const button of this.buttons) button.disabled = rests(button) ? !this.#open : !able;
    for (const control of [this.speed, this.label, ...this.marks]) control.disabled = !able;
    const steer = byId("steer");
    steer.disabled = !this.#open || (this.#taken && !this.#steers);
    steer.firstChild.textContent = this.#steers ? "Let go " : "Take control ";
    steer.setAttribute("aria-pressed", String(this.#steers));
  }

  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (byId("steering").hidden) return;
    // While a list is chosen from, the arms can be brought to rest all the same.
    const rests = /^[ps]$/i.test(event.key) && event.target.tagName === "SELECT";
    if (takesLetters(event.target) && !rests) return;
    if (event.key === "+" || event.key === "-") {
      if (this.speed.disabled) return;
      const percent = Math.min(100, Math.max(1, Number(this.speed.value) + (event.key === "+" ? 10 : -10)));
      this.speed.value = percent;
      byId("speed-out").textContent = `${percent} %`;
      this.command(`speed ${percent}`);
      return;
    }
    const key = event.key.toLowerCase();
    const button = document.querySelector(`#steering button[data-key="${CSS.escape(key)}"]`);
    if (button && !button.disabled && !button.closest("[hidden]")) {
      event.preventDefault();
      button.click();
    }
  }
}
