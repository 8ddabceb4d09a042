// Emulated drives: what each is doing, how busy their buses are, and what has happened.

import { byId, element, text } from "./dom.js";

const number = (value, unit) => (value === null ? "–" : unit === "m" ? `${(value * 1000).toFixed(2)} mm` : `${((value * 180) / Math.PI).toFixed(2)}°`);

/** How well a drive does, for its colour. */
function tone({ state, error }) {
  if (error || /fault|no power/.test(state)) return "bad";
  if (state === "operation enabled") return "good";
  return state === "quick stop active" ? "warn" : "";
}

export class Drives {
  #rows = new Map();
  #said = "";

  /** Shows what the drives are said to be; in words what a listener should hear. */
  show(news) {
    text(byId("time"), `${news.seconds.toFixed(2)} s`);
    news.arms.forEach((arm, index) => this.#arm(arm, index));
    this.buses(news.buses);
    const facts = [
      ["Episode", news.episode_s === null ? "not begun: a master has not enabled all drives" : `${news.episode_s.toFixed(1)} s`],
      ["Frames lost", String(news.frames_lost)],
      ["Kept waiting by this machine", `${news.stalled_s.toFixed(3)} s`],
    ];
    for (const [name, value] of facts) this.#fact(name, value);
    const said = news.happened.map(({ seconds, text: line }) => `${seconds.toFixed(2)} s  ${line}`);
    if (said.join("\n") !== this.#said) {
      this.#said = said.join("\n");
      byId("happened").replaceChildren(...said.reverse().map((line) => element("li", "", line)));
    }
  }

  #arm({ name, axes }, index) {
    const enabled = axes.filter(({ state }) => state === "operation enabled").length;
    const troubled = axes.some((axis) => tone(axis) === "bad");
    const chip = document.querySelectorAll("#chips .chip")[index];
    if (chip) {
      chip.dataset.state = troubled ? "FAULT" : enabled === axes.length ? "ENABLED" : "DISABLED";
      text(chip.querySelector("b"), `${enabled} of ${axes.length} enabled`);
    }
    axes.forEach((axis, place) => this.#axis(name, place, axis));
  }

  #axis(arm, place, axis) {
    const key = `${arm} ${place}`;
    let row = this.#rows.get(key);
    if (!row) {
      if (place === 0) byId("drive-arms").append(element("h3", "", arm));
      const root = element("div", "drive");
      row = { root };
      for (const part of ["name", "state", "at", "more", "error"]) row[part] = root.appendChild(element("span", part));
      byId("drive-arms").append(root);
      this.#rows.set(key, row);
    }
    row.root.dataset.tone = tone(axis);
    const name = axis.name.replaceAll("_", " ");
    text(row.name, axis.node === null ? name : `${name} · node ${axis.node}`);
    text(row.state, axis.state);
    const off = axis.wanted === null ? "" : `, wanted ${number(axis.wanted, axis.unit)}`;
    text(row.at, `${number(axis.position, axis.unit)}${off}`);
    text(row.more, axis.node === null ? "" : `${axis.nmt}, ${axis.mode}`);
    text(row.error, axis.error ?? "");
    row.error.hidden = !axis.error;
  }

  /** Shows the buses of drives, or of a run whose arms are on some. */
  buses(buses) {
    document.body.toggleAttribute("data-buses", buses.length > 0);
    for (const { interface: name, load, frames_per_s: rate, errors } of buses) {
      const value = `${(load * 100).toFixed(1)} % busy, ${rate.toLocaleString("en").replaceAll(",", "\u202f")} frames/s, ${errors} errors and drops`;
      this.#fact(name, value, load > 0.8 || errors > 0 ? "warn" : "");
    }
  }

  #fact(name, value, mood = "") {
    let entry = this.#rows.get(name);
    if (!entry) {
      entry = element("dd");
      byId("drive-facts").append(element("dt", "", name), entry);
      this.#rows.set(name, entry);
    }
    text(entry, value);
    entry.dataset.tone = mood;
  }
}
