// The panel of teleoperation: which arm which device moves, and the hands that the run is told of.

import { Drag, Keyboard, Mover, Presses, VirtualHand, gamepads, padKeys, padMotion } from "./hands.js";
import { Headset } from "./headset.js";
import { SpaceMouse, canConnect } from "./spacemouse.js";
import { byId, takesLetters } from "./dom.js";

// As often as the run looks at the hands; it lets go of what it does not hear of for a tenth of a second.
const EVERY_MS = 8;
/** How wide a picture is for a hand where it is not known what it shows, m. */
const PICTURE_M = 0.2;
/** An angle that is heard is not said anew for each degree. */
const HEARD_DEG = 15;
const PHASES = { waiting: "waits for its start", running: "is recorded", writing: "is written" };

export class Teleop {
  #send;
  #steers = false;
  #log = false;
  #open = false;
  #status = null;
  #arm = 0;
  #names = [];
  #hands = [new VirtualHand(), new VirtualHand()];
  #movers = [new Mover(), new Mover()];
  #presses = new Presses();
  #keyboard = new Keyboard();
  #cap = new SpaceMouse();
  #picture = null;
  #drag;
  #held = false;
  #other = false;
  #before = performance.now();
  #dragging = false;
  #aligning = false;
  #driver = null;

  constructor(send, cameras, scene) {
    this.#send = send;
    this.#drag = new Drag(byId("views"), () => cameras.image(this.#picture?.camera ?? 0));
    const eyes = {
      images: () => [this.#picture?.camera ?? 0, this.#picture?.right ?? this.#picture?.camera ?? 0].map((camera) => cameras.image(camera)),
      want: (on) => {
        scene.rest(on);
        cameras.elsewhere(on);
        cameras.also(on && Number.isInteger(this.#picture?.right) ? [this.#picture.right] : []);
      },
      uploaded: (image) => cameras.uploaded(image),
    };
    const more = {
      words: () => [...this.#lines(), ...said()],
      scene: (canvas) => scene.inHeadset(canvas),
      turn: (...push) => scene.turnInHeadset(...push),
      press: (keys) => {
        if (!this.#status?.desk) this.#press(keys);
      },
    };
    this.headset = new Headset((arms) => this.#tell(arms), () => this.#status?.arms.length ?? 1, eyes, more);
    this.#listen();
    setInterval(() => this.#tick(), EVERY_MS);
  }

  facts({ arms, picture, log }) {
    // Of a log the panel shows what was, and nothing moves.
    this.#log = Boolean(log);
    byId("teleop").dataset.log = String(this.#log);
    this.#names = arms;
    this.#picture = picture ?? null;
    this.#choose(Math.min(this.#arm, arms.length - 1));
  }

  seat({ steers }) {
    this.#steers = steers;
    if (!steers) this.#letGo();
    this.#show();
  }

  link(open) {
    this.#open = open;
    if (!open) {
      this.#steers = false;
      this.#letGo();
    }
    this.#show();
  }

  /** What the run says of hands; nothing if they do not move its arms. */
  state(status) {
    this.#status = status ?? null;
    byId("teleop").hidden = !status;
    document.body.classList.toggle("by-hand", Boolean(status) && !this.#log);
    this.#drag.on = Boolean(status) && this.#steers && !status.desk;
    if (!status) return;
    // A log of before there was a line for it does not say the scale; no log says the alignment.
    byId("scale-row").hidden = status.scale === null;
    if (!this.#dragging && status.scale !== null) {
      byId("scale").value = Math.round(status.scale * 100);
      byId("scale-out").textContent = `${Math.round(status.scale * 100)} %`;
    }
    if (!this.#aligning && status.align_deg !== null) {
      byId("align").value = Math.round(status.align_deg);
      byId("align-out").textContent = `${Math.round(status.align_deg)}°`;
    }
    this.#showDriver(status);
    this.#showArms(status);
    this.#showRecording(status.recording);
    const label = byId("label");
    if (document.activeElement !== label && label.value !== status.label) label.value = status.label;
  }

  /** In words what each arm does, for those who hear the page; while a policy drives there is nothing to say. */
  words() {
    if (this.#status?.driver === "policy") return "";
    return this.#lines(HEARD_DEG).join("; ");
  }

  /** A line for each arm, with angles in steps of so many degrees. */
  #lines(step_deg = 1) {
    return (this.#status?.arms ?? []).map((arm, index) => `${this.#names[index] ?? ""} ${word(arm, this.#status, step_deg, this.#log)}`);
  }

  #listen() {
    const scale = byId("scale");
    scale.oninput = () => {
      this.#dragging = true;
      byId("scale-out").textContent = `${scale.value} %`;
    };
    scale.onchange = () => {
      this.#dragging = false;
      this.#send({ scale: Number(scale.value) / 100 });
    };
    const align = byId("align");
    align.oninput = () => {
      this.#aligning = true;
      byId("align-out").textContent = `${align.value}°`;
    };
    align.onchange = () => {
      this.#aligning = false;
      this.#send({ align: Number(align.value) });
    };
    const hold = byId("hold");
    const holds = (on) => () => { this.#held = on; };
    hold.onpointerdown = (event) => {
      hold.setPointerCapture(event.pointerId);
      this.#held = true;
    };
    for (const end of ["onpointerup", "onpointercancel", "onblur"]) hold[end] = holds(false);
    hold.onkeydown = (event) => {
      if ((event.key === " " || event.key === "Enter") && !event.repeat) this.#held = true;
    };
    hold.onkeyup = holds(false);
    for (const button of document.querySelectorAll("#episode button")) {
      button.onclick = () => this.#send({ episode: button.dataset.episode });
    }
    const label = byId("label");
    label.oninput = () => this.#send({ label: label.value });
    label.onkeydown = ({ key }) => {
      if (key === "Enter" || key === "Escape") label.blur();
    };
    byId("hand-back").onclick = () => this.#send({ hand_back: true });
    const connect = byId("connect-cap");
    connect.hidden = !canConnect();
    connect.onclick = () => this.#cap.connect().catch((error) => { byId("device").textContent = `No SpaceMouse: ${error.message}`; });
    byId("enter-vr").onclick = () => this.headset.toggle();
    document.addEventListener("keydown", (event) => this.#key(event));
    window.addEventListener("blur", () => this.#hidden());
    window.addEventListener("pagehide", () => this.#hidden());
    document.addEventListener("visibilitychange", () => document.hidden && this.#hidden());
  }

  // Keys of the panel's buttons.
  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat || this.#log || byId("teleop").hidden) return;
    if (takesLetters(event.target)) return;
    const button = document.querySelector(`#teleop button[data-key="${CSS.escape(event.key.toLowerCase())}"]`);
    if (button && canBeClicked(button)) {
      event.preventDefault();
      button.click();
    }
  }

  /** A device's button is the page's button of one of these keys, the first that can be clicked: of the episode, of a robot's run, or to hand back. */
  #press(keys) {
    const buttons = [...keys].flatMap((key) => [...document.querySelectorAll(`:is(#teleop, #mark) button[data-key="${key}"]`)]);
    buttons.find(canBeClicked)?.click();
  }

  #hidden() {
    if (this.headset.running) return;
    this.#letGo();
    if (this.#status && !this.#status.desk && !this.#log) this.#send({ hands_off: true });
  }

  #letGo() {
    this.#held = false;
    this.#keyboard.clear();
    this.#drag.clear();
    this.#cap.clear();
  }

  #choose(arm) {
    // A clutch that is held is that of the arm before.
    if (arm !== this.#arm) this.#letGo();
    this.#arm = Math.max(0, arm);
    const choice = byId("which-arm");
    choice.hidden = this.#names.length < 2;
    choice.replaceChildren(...this.#names.map((name, index) => {
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.key = String(index + 1);
      button.setAttribute("aria-pressed", String(index === this.#arm));
      const key = document.createElement("kbd");
      key.textContent = String(index + 1);
      button.append(`${name} `, key);
      button.onclick = () => this.#choose(index);
      return button;
    }));
  }

  #tick() {
    const now = performance.now();
    const seconds = Math.min(0.05, (now - this.#before) / 1000);
    this.#before = now;
    if (this.#status?.desk) byId("device").textContent = "Devices: those at the robot's computer.";
    if (this.#status?.desk || !this.#open || !this.#steers || document.hidden || this.headset.running) {
      this.#presses.clear();
      return;
    }
    const pads = gamepads();
    if (this.#status) this.#move(pads, now, seconds);
    this.#listenTo(pads);
  }

  /** Buttons of gamepads, which mean something while no clutch is held. */
  #listenTo(pads) {
    const presses = this.#presses.take(pads.map((pad) => [pad.index, padKeys(pad)]));
    const clutch = this.#hands.some((hand) => hand.clutch) || pads.some((pad) => padMotion(pad).clutch);
    if (!clutch) presses.forEach((keys) => this.#press(keys));
  }

  #move(pads, now, seconds) {
    const count = this.#status.arms.length;
    const alone = count === 1 || pads.length < 2;
    const motions = Array.from({ length: count }, (_, arm) =>
      this.#movers[arm].motion(alone ? (arm === this.#arm ? pads[0] : undefined) : pads[arm]));
    const other = Boolean(alone && motions[this.#arm]?.other);
    if (other && !this.#other && count > 1) this.#choose((this.#arm + 1) % count);
    this.#other = other;
    this.#tell(motions.map((motion, index) => this.#hand(index, motion, now, seconds)));
    byId("device").textContent = devices(pads.length, this.#cap.connected);
  }

  /** The hand of an arm after what its devices ask for. */
  #hand(index, pad, now, seconds) {
    const hand = this.#hands[index];
    const chosen = index === this.#arm;
    const keys = this.#keyboard.motion(now);
    const byDesk = chosen && (keys.clutch || this.#cap.clutch || this.#held || this.#drag.clutch);
    hand.hold(Boolean(pad?.clutch) || byDesk, this.#status.arms[index].jaw);
    if (pad?.clutch) {
      hand.move(pad, seconds);
      hand.jaw = pad.trigger;
    } else if (byDesk) {
      const cap = this.#cap.motion(now, hand.jaw);
      hand.move(keys, seconds);
      hand.move(cap, seconds);
      hand.move(this.#drag.take(this.#wide(index), seconds), 1);
      hand.jaw = Math.min(1, Math.max(0, hand.jaw + (keys.jaw + cap.jaw) * seconds));
    }
    return hand.told;
  }

  /** What way of the hand takes the tip of an arm across the picture, m: what is dragged stays under the pointer. */
  #wide(index) {
    const tip = this.#status.arms[index].tip;
    if (!tip || !this.#picture) return PICTURE_M;
    return (this.#picture.wide * -tip[2]) / this.#status.scale;
  }

  #tell(arms) {
    if (this.#status?.desk) return;
    this.#send({ hands: { t: performance.now(), arms } });
  }

  #show() {
    const able = this.#open && this.#steers;
    for (const control of document.querySelectorAll("#teleop button, #teleop input")) control.disabled = !able;
    if (this.#status) this.#showDriver(this.#status);
    const mono = this.#picture && this.#picture.right === null;
    byId("mono").hidden = true;
    this.headset.offer([byId("enter-vr"), byId("align-row"), byId("scene-vr-row"), ...(mono ? [byId("mono")] : [])], able);
  }

  /** Who drives, where a policy does too. */
  #showDriver({ driver, recording }) {
    const waits = recording && recording.phase !== "running";
    const line = byId("driver");
    line.hidden = !driver || Boolean(waits);
    byId("hand-back").hidden = line.hidden;
    if (!driver) return;
    line.dataset.driver = driver;
    const live = driver === "policy" ? "The policy drives. Hold the clutch to take over." : "You drive. The arms hold when you let go.";
    const text = this.#log ? `The ${driver} drives.` : live;
    if (line.textContent !== text) line.textContent = text;
    byId("hand-back").disabled = !this.#open || !this.#steers || driver === "policy";
    // Beside a policy the keys are out of the way until they are wanted.
    if (driver !== this.#driver) byId("hand-keys").open = driver === "operator";
    this.#driver = driver;
  }

  #showArms({ arms }) {
    const list = byId("hands");
    const lines = this.#lines();
    while (list.children.length > arms.length) list.lastChild.remove();
    arms.forEach((arm, index) => {
      const item = list.children[index] ?? list.appendChild(document.createElement("li"));
      item.dataset.engaged = String(arm.engaged);
      const mark = arm.engaged ? "●" : "○";
      const text = `${mark} ${lines[index]}`;
      if (item.textContent !== text) item.textContent = text;
    });
  }

  #showRecording(recording) {
    byId("episode").hidden = !recording;
    if (!recording) return;
    const { phase, kept, wanted, seed } = recording;
    byId("episode-state").textContent = `${kept} of ${wanted} episodes kept; seed ${seed} ${PHASES[phase]}.`;
    for (const button of document.querySelectorAll("#episode button")) {
      const applies = phase === (button.dataset.episode === "start" ? "waiting" : "running");
      button.disabled = !this.#open || !this.#steers || !applies;
    }
  }
}

/** What the page says of the episode under way, or of the mark of a robot's run. */
function said() {
  const lines = [["episode", "episode-state"], ["mark", "mark-state"]];
  return lines.filter(([group]) => !byId(group).hidden).map(([, line]) => byId(line).textContent);
}

const canBeClicked = (button) => !button.disabled && !button.closest("[hidden]");

function word(arm, { driver, align_deg }, step_deg, log) {
  if (driver === "policy" && !arm.engaged) return "follows the policy";
  if (arm.engaged) return "follows the hand";
  if (arm.misaligned_deg !== null) {
    const off = Math.ceil(arm.misaligned_deg / step_deg) * step_deg;
    return `holds: the controller is ${off}° off the instrument; turn it within ${align_deg}°`;
  }
  if (!arm.lost) return "holds";
  return log ? `holds: ${arm.lost}` : `holds: ${arm.lost}; let go, then hold again`;
}

function devices(pads, cap) {
  const more = pads === 0 ? "" : pads === 1 ? ", one gamepad" : `, ${pads} gamepads`;
  const space = cap ? ", SpaceMouse" : "";
  return `Devices: keyboard, mouse on the picture${more}${space}.`;
}
