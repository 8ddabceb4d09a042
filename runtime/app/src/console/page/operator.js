// The operator's buttons, slider and keys.

import { byId, takesLetters } from "./dom.js";

export class Operator {
  #send;
  #steers = false;
  #taken = false;
  #open = false;
  #dragging = false;

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

  #show() {
    const able = this.#open && this.#steers;
    // Pause and stop bring the arms to rest: any page may.
    const rests = ({ dataset }) => dataset.command === "pause" || dataset.command === "stop";
    for (const button of this.buttons) button.disabled = rests(button) ? !this.#open : !able;
    this.speed.disabled = !able;
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
    if (button && !button.disabled) {
      event.preventDefault();
      button.click();
    }
  }
}
