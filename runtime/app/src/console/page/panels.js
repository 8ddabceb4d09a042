// What the newest state says, in numbers and meters.

import { showCriteria } from "./criteria.js";
import { byId, element, text } from "./dom.js";

/** A list of facts whose entries stay where they are. */
class FactList {
  #entries = new Map();

  constructor(id) {
    this.root = byId(id);
  }

  set(name, value, tone = "") {
    let entry = this.#entries.get(name);
    if (!entry) {
      entry = element("dd");
      this.root.append(element("dt", "", name), entry);
      this.#entries.set(name, entry);
    }
    text(entry, value);
    entry.dataset.tone = tone;
  }

  clear() {
    this.root.replaceChildren();
    this.#entries.clear();
  }
}

const angle = (value) => `${((value * 180) / Math.PI).toFixed(1)}°`;
const length = (value) => `${(value * 1000).toFixed(1)} mm`;
const ago = (seconds) => (seconds === null ? "never" : seconds < 0.1 ? "now" : `${seconds.toFixed(1)} s ago`);
const count = (value) => value.toLocaleString("en").replaceAll(",", "\u202f");
const micro = (us) => (us >= 1000 ? `${(us / 1000).toFixed(1)} ms` : `${Math.round(us)} µs`);

/** A change of the filter that is older says nothing of now, s. */
const FRESH_S = 0.3;

function meter(kind) {
  const root = element("div", `meter ${kind}`);
  if (kind === "velocity") root.append(element("i", "zero"));
  const wanted = root.appendChild(element("i", "wanted"));
  const commanded = root.appendChild(element("i", "commanded"));
  const measured = root.appendChild(element("i", "measured"));
  measured.hidden = true;
  commanded.hidden = true;
  wanted.hidden = true;
  return { root, measured, commanded, wanted };
}

function place(mark, value, low, high) {
  mark.hidden = value === null || value === undefined;
  if (mark.hidden) return;
  const share = Math.min(1, Math.max(0, (value - low) / (high - low)));
  // The style is set by script, which the content security policy allows, unlike a style attribute. A mark at an end stays inside.
  mark.style.left = `clamp(1.5px, ${(100 * share).toFixed(2)}%, 100% - 1.5px)`;
}

export class Panels {
  #facts = null;
  #arms = [];
  #histograms = new Map();
  #rows = "";

  constructor() {
    this.safety = new FactList("safety");
    this.loop = new FactList("loop");
    this.task = new FactList("task");
  }

  facts(facts) {
    this.#facts = facts;
    text(byId("title"), facts.title);
    const { episodes } = facts;
    text(byId("path-name"), episodes ? "Path of the actions, 1 s" : "Path of the chunk");
    const how = episodes ? `dataset · ${episodes.length} ${episodes.length === 1 ? "episode" : "episodes"}` : facts.log ? "log" : { run: "live", recording: "recording", drives: "emulated drives" }[facts.subject];
    text(byId("about"), [how, facts.policy && `${episodes ? "by" : "policy"} ${facts.policy}`, !episodes && `seed ${facts.seed}`].filter(Boolean).join(" · "));
    document.title = `${facts.title} – Trocar console`;
    byId("chips").replaceChildren();
    byId("arms").replaceChildren();
    this.#arms = facts.arms.map((name) => this.#arm(name));
    byId("change").replaceChildren();
    this.changes = facts.arms.flatMap((arm) => facts.axes.map((axis) => {
      const cell = element("div");
      const value = cell.appendChild(element("b", "", "–"));
      const name = cell.appendChild(element("span", "", axis.name.replace("wrist_", "w. ")));
      name.title = `${arm} ${axis.name}`;
      byId("change").append(cell);
      return value;
    }));
    this.loop.clear();
    byId("histograms").replaceChildren();
    this.#histograms.clear();
    this.task.clear();
    this.task.set("Task", facts.title);
    this.task.set("Policy", facts.policy);
  }

  state(state) {
    if (!this.#facts) return;
    text(byId("time"), `${state.seconds.toFixed(2)} s`);
    state.arms.forEach((arm, index) => {
      this.#showArm(arm, this.#arms[index]);
      this.#showWanted(arm, this.#arms[index], state.filter, index);
    });
    this.#showSafety(state);
    this.#showLoop(state);
    this.#showTask(state);
  }

  /** A frame of a dataset: what was measured, and where the action wants the joints. */
  frame({ seconds, arms }) {
    if (!this.#facts) return;
    text(byId("time"), `${seconds.toFixed(2)} s`);
    arms.forEach((arm, index) => {
      this.#arms[index]?.axes.forEach(({ axis, position, value, velocity, speed }, i) => {
        const unit = axis.unit === "m" ? length : angle;
        place(position.measured, arm.measured[i], axis.low, axis.high);
        place(position.commanded, arm.wanted?.[i], axis.low, axis.high);
        text(value, unit(arm.measured[i]));
        place(velocity.measured, arm.measured_velocity[i], -axis.velocity, axis.velocity);
        text(speed, `${unit(arm.measured_velocity[i])}/s`);
      });
    });
  }

  #arm(name) {
    const chip = element("li", "chip");
    chip.append(element("span", "", name));
    const state = chip.appendChild(element("b", "", "–"));
    const more = chip.appendChild(element("span", "quiet", ""));
    byId("chips").append(chip);
    const root = element("div", "arm");
    root.append(element("h3", "", name));
    const axes = this.#facts.axes.map((axis) => {
      const line = element("div", "axis");
      line.append(element("span", "name", axis.name.replace("_", " ")));
      const position = meter("position");
      const value = element("span", "value", "–");
      const velocity = meter("velocity");
      const speed = element("span", "value quiet", "–");
      line.append(position.root, value, velocity.root, speed);
      place(velocity.root.querySelector(".zero"), 0, -1, 1);
      root.append(line);
      return { axis, line, position, value, velocity, speed };
    });
    byId("arms").append(root);
    return { chip, state, more, axes };
  }

  #showArm(arm, view) {
    if (!view) return;
    view.chip.dataset.state = arm.state;
    text(view.state, arm.state);
    const notes = [arm.homed ? "homed" : "not homed", arm.busy ? "moving" : "at rest"];
    if (arm.fault) notes.push(arm.fault);
    if (arm.error) notes.push(arm.error);
    text(view.more, notes.join(", "));
    view.axes.forEach(({ axis, position, value, velocity, speed }, i) => {
      const unit = axis.unit === "m" ? length : angle;
      const measured = arm.measured?.[i];
      place(position.measured, measured, axis.low, axis.high);
      place(position.commanded, arm.commanded[i], axis.low, axis.high);
      const room = Math.min(arm.commanded[i] - axis.low, axis.high - arm.commanded[i]);
      position.root.dataset.near = String(room < 0.03 * (axis.high - axis.low));
      text(value, measured === undefined || measured === null ? "not known" : unit(measured));
      const rate = arm.measured_velocity?.[i];
      place(velocity.measured, rate, -axis.velocity, axis.velocity);
      place(velocity.commanded, arm.commanded_velocity[i], -axis.velocity, axis.velocity);
      velocity.root.dataset.near = String(Math.abs(arm.commanded_velocity[i]) > 0.97 * axis.velocity);
      text(speed, `${unit(arm.commanded_velocity[i])}/s`);
    });
  }

  /** What was wanted of each axis before the filter's newest change, and which axes its active rows hold. */
  #showWanted(arm, view, filter, index) {
    if (!view) return;
    const fresh = filter.ago_s !== null && filter.ago_s < FRESH_S;
    const rows = fresh ? filter.rows.filter((row) => row.startsWith(`${arm.name} `)) : [];
    view.axes.forEach(({ axis, line, velocity }, i) => {
      const change = fresh ? (filter.change[index * view.axes.length + i] ?? 0) : 0;
      const changed = Math.abs(change) >= 0.005;
      const wanted = arm.commanded_velocity[i] - change * axis.velocity;
      place(velocity.wanted, changed ? wanted : null, -axis.velocity, axis.velocity);
      // A bound of its own holds an axis, or a row in space through what it changed of it.
      const holds = rows.filter((row) => (row.endsWith(" bound") ? row.startsWith(`${arm.name} ${axis.name},`) : changed));
      line.dataset.held = String(holds.length > 0);
      line.title = holds.join("; ");
    });
  }

  #showSafety(state) {
    const { counts, filter } = state;
    this.safety.set("Motion passed unchanged", count(counts.passed));
    this.safety.set("Corrected by the QP", count(counts.solved), counts.solved ? "warn" : "");
    this.safety.set("QP failed, arm told to stop", count(counts.failed), counts.failed ? "bad" : "");
    const corrections = state.arms.map((arm) => arm.correction.toFixed(3)).join(", ");
    this.safety.set("Correction now", `${corrections} of the limits`);
    const guard = counts.guard ? `${count(counts.guard)}, last ${ago(counts.guard_ago_s)}` : "0";
    this.safety.set("Guard interventions", guard, counts.guard ? "warn" : "good");
    this.safety.set("Chunks refused by the gate", count(counts.refused), counts.refused ? "warn" : "good");
    this.safety.set("Last refusal", counts.last_refused ?? "none");
    const rows = filter.ago_s === null ? ["none yet"] : filter.rows.map((row) => `${row}`);
    if (filter.more > 0) rows.push(`and ${filter.more} more`);
    if (filter.ago_s !== null) rows.unshift(ago(filter.ago_s));
    const key = rows.join("\n");
    if (key !== this.#rows) {
      this.#rows = key;
      byId("rows").replaceChildren(...rows.map((row, i) => element("li", i === 0 ? "quiet" : "", row)));
    }
    this.changes.forEach((cell, i) => {
      const value = filter.change[i];
      text(cell, value === undefined ? "–" : Math.abs(value) < 0.005 ? "0" : value.toFixed(2));
    });
  }

  #showLoop(state) {
    const { timing } = state;
    this.#histogram("Tick compute", timing.compute);
    this.#histogram("Wake-up late by", timing.wake);
    this.#histogram("Period", timing.period, this.#facts.period_buckets_us);
    this.loop.set("Ticks", count(state.counts.ticks));
    this.loop.set("Overruns (skipped periods)", count(timing.overruns), timing.overruns ? "warn" : "good");
    if (state.silent_s > 0.3) this.loop.set("Loop silent for", `${state.silent_s.toFixed(1)} s`, "bad");
    else if (!this.#facts.log) this.loop.set("Loop silent for", "0 s", "good");
  }

  #showTask(state) {
    const limit = this.#facts.time_limit_s;
    if (limit) this.task.set("Time", `${state.seconds.toFixed(1)} of ${limit} s`);
    showCriteria(state.criteria ?? []);
    this.task.set("Chunks", count(state.counts.chunks));
    const latency = state.latency;
    const known = state.counts.chunks > 0;
    this.task.set("Observation to chunk", known ? `${micro(latency.newest_us)}, at most ${micro(latency.max_us)}` : "–");
    const eye = state.teleop?.camera_to_page_ms;
    if (eye) this.task.set("Camera to page", `${eye.p50.toFixed(0)} ms, 95 % within ${eye.p95.toFixed(0)} ms`);
    const follows = state.arms.map((arm) => (arm.follows ? "yes" : "no")).join(", ");
    this.task.set("Follows a chunk", follows);
    this.task.set("Speed limits", `${state.speed_percent} %`);
  }

  #histogram(name, { counts, newest_us, max_us }, buckets = this.#facts.buckets_us) {
    let view = this.#histograms.get(name);
    if (!view) {
      const root = element("div", "histogram");
      const head = root.appendChild(element("h3", "", name));
      const numbers = head.appendChild(element("span", "quiet"));
      const bars = root.appendChild(element("div", "bars"));
      const ends = root.appendChild(element("div", "ends"));
      const all = [...buckets, null].map((end, i) => {
        const label = end === null ? "" : end >= 1000 ? `${end / 1000} ms` : `${end} µs`;
        ends.append(element("span", "", i % 3 === 0 ? label : ""));
        return bars.appendChild(element("i"));
      });
      byId("histograms").append(root);
      view = { bars, numbers, all };
      this.#histograms.set(name, view);
    }
    const total = counts.reduce((sum, n) => sum + n, 0);
    const most = Math.max(1, ...counts);
    let below = 0;
    const median = buckets[counts.findIndex((n) => (below += n) * 2 >= total)];
    counts.forEach((n, i) => {
      // Roots make the rare ones visible.
      view.all[i].style.height = n ? `${Math.max(4, 100 * Math.sqrt(n / most))}%` : "0";
    });
    const middle = total ? `median ≤ ${micro(median ?? Infinity)} · ` : "";
    text(view.numbers, `${middle}now ${micro(newest_us)} · max ${micro(max_us)}`);
    view.bars.setAttribute("role", "img");
    view.bars.setAttribute("aria-label", `${name}: ${middle}max ${micro(max_us)}, ${total} ticks`);
  }
}
