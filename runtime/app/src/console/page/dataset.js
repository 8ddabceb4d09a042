// A dataset: which episode is looked at, what was noted of it, and a frame's tips and actions.

import { byId, element, takesLetters, text } from "./dom.js";

const millimetres = (value) => `${(value * 1000).toFixed(1)} mm`;
const degrees = (value) => `${((value * 180) / Math.PI).toFixed(1)}°`;

/** The angle between two quaternions x, y, z, w, rad. */
const angleBetween = (one, other) => 2 * Math.acos(Math.min(1, Math.abs(one.reduce((sum, value, i) => sum + value * other[i], 0))));

/** Rows of an arm's table: what of the measured state and tip, and of the action. */
const ROWS = [
  ...["x", "y", "z"].map((name, axis) => [name, ({ tip }) => millimetres(tip[axis]), ({ action }) => millimetres(action[axis])]),
  ["turn to go", () => "", ({ tip, action }) => degrees(angleBetween(tip.slice(3), action.slice(3, 7)))],
  ["jaw", ({ measured }) => degrees(measured[6]), ({ action }) => degrees(action[7])],
];

export class Episodes {
  #send;
  #timeline;
  #facts = null;
  #chosen = 0;
  #tables = [];

  constructor(send, timeline) {
    this.#send = send;
    this.#timeline = timeline;
    byId("chosen").onchange = () => this.#choose(byId("chosen").selectedIndex);
    byId("previous").onclick = () => this.#choose(this.#chosen - 1);
    byId("next").onclick = () => this.#choose(this.#chosen + 1);
    document.addEventListener("keydown", (event) => this.#key(event));
  }

  facts(facts) {
    this.#facts = facts.episodes ? facts : null;
    if (!this.#facts) return;
    byId("chosen").replaceChildren(...facts.episodes.map(({ note }, index) => new Option(name(note, index), String(index))));
    this.#tables = facts.arms.map(table);
    byId("actions").replaceChildren(...this.#tables.map(({ root }) => root));
    this.#chosen = Math.min(this.#chosen, facts.episodes.length - 1);
    this.#open();
  }

  frame({ episode, frame, by_hand: byHand, arms }) {
    if (!this.#facts || episode !== this.#chosen) return;
    const driven = byId("driven");
    driven.hidden = byHand === null;
    driven.dataset.driver = byHand ? "operator" : "policy";
    text(driven, byHand ? "The operator drives" : "The policy drives");
    byId("at").setAttribute("aria-valuetext", `frame ${frame} of ${this.#facts.episodes[episode].frames}`);
    arms.forEach((arm, index) => {
      this.#tables[index]?.cells.forEach(([measured, action], row) => {
        text(measured, ROWS[row][1](arm));
        text(action, ROWS[row][2](arm));
      });
    });
  }

  #choose(index) {
    if (!this.#facts || index === this.#chosen || index < 0 || index >= this.#facts.episodes.length) return;
    this.#chosen = index;
    this.#timeline.rewind();
    this.#open();
  }

  #open() {
    const { episodes, fps } = this.#facts;
    const episode = episodes[this.#chosen];
    byId("chosen").selectedIndex = this.#chosen;
    byId("previous").disabled = this.#chosen === 0;
    byId("next").disabled = this.#chosen === episodes.length - 1;
    const noted = [["Frames", `${episode.frames} at ${fps} a second`], ...flat(episode.note ?? {})];
    byId("noted").replaceChildren(...noted.flatMap(([key, value]) => [element("dt", "", key), element("dd", "", value)]));
    this.#send({ open: this.#chosen });
    this.#timeline.show({ ...episode, fps }, `${episode.frames} frames`);
  }

  #key(event) {
    if (!this.#facts || event.ctrlKey || event.altKey || event.metaKey || takesLetters(event.target)) return;
    const step = { "[": -1, "]": 1 }[event.key];
    if (step) this.#choose(this.#chosen + step);
  }
}

/** What an episode is called in the list. */
function name(note, index) {
  return [String(index), note?.seed !== undefined && `seed ${note.seed}`, note?.label].filter(Boolean).join(" · ");
}

/** What was noted, a line for each number and text; of what lies deeper the way to it is part of the name. */
function flat(note, prefix = "") {
  return Object.entries(note).flatMap(([key, value]) => {
    const path = `${prefix}${key.replaceAll("_", " ")}`;
    if (value === null || key === "episode_index") return [];
    if (Array.isArray(value)) return [[path, value.some((one) => typeof one === "object") ? `${value.length}` : value.join(", ")]];
    if (typeof value === "object") return flat(value, `${path}, `);
    return [[path, typeof value === "number" ? String(Number(value.toFixed(4))) : String(value)]];
  });
}

/** The table of an arm. */
function table(arm) {
  const root = element("table");
  const caption = root.appendChild(element("caption", "visually-hidden", `${arm}: tip measured and commanded`));
  caption.id = `actions-${arm}`;
  const head = root.appendChild(element("thead")).appendChild(element("tr"));
  for (const title of [arm, "measured", "action"]) head.appendChild(element("th", "", title)).scope = "col";
  const body = root.appendChild(element("tbody"));
  const cells = ROWS.map(([title]) => {
    const row = body.appendChild(element("tr"));
    row.appendChild(element("th", "", title)).scope = "row";
    return [row.appendChild(element("td")), row.appendChild(element("td"))];
  });
  return { root, cells };
}
