// The page: one connection, and the panels that show what it says.

import { Cameras } from "./cameras.js";
import { Connection } from "./connection.js";
import { Episodes } from "./dataset.js";
import { Drives } from "./drives.js";
import { Operator } from "./operator.js";
import { Panels } from "./panels.js";
import { Recording } from "./recording.js";
import { Scene } from "./scene.js";
import { SCENE } from "./scene_file.js";
import { Teleop } from "./teleop.js";
import { Timeline } from "./timeline.js";

import { byId } from "./dom.js";

// The token has come as a cookie; it needs not stand in the address, nor in the history.
if (location.search) history.replaceState(null, "", location.pathname);

let connection = null;
const send = (message) => connection?.send(message);
const panels = new Panels();
const scene = new Scene(() => cameras.want());
const cameras = new Cameras(send, () => (scene.wanted ? [[SCENE, "colour"]] : []));
const operator = new Operator(send);
const timeline = new Timeline(send);
const episodes = new Episodes(send, timeline);
const teleop = new Teleop(send, cameras, scene);
const drives = new Drives();
const recording = new Recording();
let link = "waiting";
let ended = null;
let log = false;
let said = "";
// A page asks for the seat once a connection: whoever lets go of it has let go.
let asked = false;

function say(text) {
  if (text !== said) byId("live").textContent = text;
  said = text;
}

function banner(text, tone = "bad") {
  byId("banner").hidden = !text;
  byId("banner").textContent = text;
  byId("banner").dataset.tone = tone;
}

const heard = {
  facts(facts) {
    log = facts.log;
    document.body.dataset.subject = facts.subject;
    panels.facts(facts);
    cameras.set(facts.cameras, facts.log, facts.depth, facts.drawn);
    scene.facts(facts.scene);
    timeline.facts(facts);
    episodes.facts(facts);
    teleop.facts(facts);
    if (facts.subject !== "run") byId("steering").hidden = true;
    else if (!log && !asked) {
      asked = true;
      send({ steer: true });
    }
  },
  state(state) {
    panels.state(state);
    operator.setSpeed(state.speed_percent);
    operator.said(state.said);
    teleop.state(state.teleop);
    drives.buses(state.buses ?? []);
    showPaths(state.paths ?? []);
    const arms = state.arms.map((arm) => `${arm.name} ${arm.state}${arm.fault ? `: ${arm.fault}` : ""}`);
    say([...arms, teleop.words()].filter(Boolean).join("; "));
    const faults = state.arms.filter((arm) => arm.fault).map((arm) => `${arm.name}: ${arm.fault}`);
    if (!ended && link === "open") banner(faults.join("; "));
  },
  frame(frame) {
    panels.frame(frame);
    episodes.frame(frame);
    showPaths(frame.paths ?? []);
  },
  drives: (news) => drives.show(news),
  recording: (news) => recording.show(news),
  seat(seat) {
    operator.seat(seat);
    teleop.seat(seat);
  },
  answer: (answer) => operator.answer(answer),
  problem: (problem) => operator.problem(problem),
  end(end) {
    ended = end;
    const verdict = end.success === true ? "Success" : end.success === false ? "Failure" : "The run has ended";
    banner(end.reason ? `${verdict}: ${end.reason}` : verdict, end.success === false ? "bad" : "good");
    say(byId("banner").textContent);
  },
};

/** Where the newest chunk leads, in the pictures and in the scene. */
function showPaths(paths) {
  const shown = byId("path-show").checked;
  byId("path-row").hidden = paths.length === 0;
  cameras.paths(paths, shown);
  scene.paths(shown ? paths : []);
}

function showLink() {
  const age = connection?.age;
  const old = age === null || age === undefined ? "" : age < 1000 ? "" : ` · ${(age / 1000).toFixed(0)} s ago`;
  const words = {
    waiting: "connecting",
    open: !log && age > 1000 ? `no news${old}` : "connected",
    lost: `connection lost${old}`,
    over: "run ended",
  };
  byId("link").dataset.link = link === "open" && !log && age > 1000 ? "lost" : link;
  byId("link-text").textContent = words[link];
}

connection = new Connection({
  text: (message) => heard[message.kind]?.(message),
  picture: (...picture) => cameras.picture(...picture),
  places: (...places) => scene.places(...places),
  open() {
    if (!ended) banner("");
  },
  change(state, reason) {
    link = state;
    if (state !== "open") asked = false;
    operator.link(state === "open");
    teleop.link(state === "open");
    if (state === "lost" && !ended) banner(`Connection lost; what is shown is old. Trying again.${reason ? ` (${reason})` : ""}`);
    showLink();
  },
});

let before = performance.now();
setInterval(() => {
  const now = performance.now();
  cameras.rates((now - before) / 1000);
  before = now;
}, 1000);
setInterval(showLink, 250);
