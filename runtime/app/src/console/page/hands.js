// Devices that move a hand: keyboard, gamepad, mouse. Axes are the picture's: x to the right, y up, z towards the viewer.

import { takesLetters } from "./dom.js";

/** What each key does while the clutch is held: an axis of the way (m) or of the turn (rad), or the jaw. */
const KEYS = {
  ArrowRight: ["way", 0, 1], ArrowLeft: ["way", 0, -1],
  ArrowUp: ["way", 1, 1], ArrowDown: ["way", 1, -1],
  PageDown: ["way", 2, 1], PageUp: ["way", 2, -1],
  KeyI: ["turn", 0, 1], KeyK: ["turn", 0, -1],
  KeyJ: ["turn", 1, 1], KeyL: ["turn", 1, -1],
  KeyU: ["turn", 2, 1], KeyO: ["turn", 2, -1],
  KeyM: ["jaw", 0, 1], KeyN: ["jaw", 0, -1],
};
const CLUTCH_KEY = "KeyF";

// Of a hand: the tip makes a part of the way.
const KEY_M_S = 0.1;
const KEY_RAD_S = 0.8;
const KEY_JAW_1_S = 1.2;
const STICK_M_S = 0.12;
const STICK_RAD_S = 1.0;
const DEAD_ZONE = 0.15;
const DRAG_RAD = 3;
const WHEEL_M = 0.0001;
const WHEEL_RAD = 0.002;
const DRAG_M_S_MAX = 2.5;
const DRAG_RAD_S_MAX = 10;

/** No motion. */
export const still = () => ({ clutch: false, way: [0, 0, 0], turn: [0, 0, 0], jaw: 0 });

/** Keys that are down. A tap moves little: the speed grows while a key is held. */
export class Keyboard {
  #down = new Map();

  constructor() {
    document.addEventListener("keydown", (event) => this.#press(event));
    document.addEventListener("keyup", (event) => this.#down.delete(event.code));
  }

  /** As if all keys were let go. */
  clear() {
    this.#down.clear();
  }

  get clutch() {
    return this.#down.has(CLUTCH_KEY);
  }

  /** The velocities that the keys ask for at `now`, ms. */
  motion(now) {
    const asked = still();
    asked.clutch = this.clutch;
    for (const [code, since] of this.#down) {
      const key = KEYS[code];
      if (!key) continue;
      const [what, axis, sign] = key;
      const pace = sign * Math.min(1, 0.2 + (now - since) / 500);
      if (what === "jaw") asked.jaw += sign * KEY_JAW_1_S;
      else asked[what][axis] += pace * (what === "way" ? KEY_M_S : KEY_RAD_S);
    }
    return asked;
  }

  #press(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (takesLetters(event.target)) return;
    if (event.code !== CLUTCH_KEY && !(this.clutch && event.code in KEYS)) return;
    // With the clutch, arrows move the hand and not the page.
    event.preventDefault();
    // A key that goes on being held after all were let go, by force or with the focus, has to be pressed anew.
    if (event.repeat) return;
    if (!this.#down.has(event.code)) this.#down.set(event.code, performance.now());
  }
}

/** Gamepads of the standard mapping, in their order. */
export function gamepads() {
  const all = navigator.getGamepads ? [...navigator.getGamepads()] : [];
  return all.filter((pad) => pad && pad.connected && pad.mapping === "standard");
}

/** Which of the page's keys a gamepad's buttons are: Start, A, Select, B, RB. */
const PAD_KEYS = [[9, "g"], [0, "y"], [8, "z"], [1, "x"], [5, "b"]];

/** The keys of the page that a gamepad holds. */
export const padKeys = (pad) => PAD_KEYS.filter(([index]) => pad.buttons[index]?.pressed).map(([, keys]) => keys);

/** Presses of devices' buttons. One that is held as its device is first looked at is none. */
export class Presses {
  #held = new Map();

  /** What has been pressed since the last look, of each device with what it holds. */
  take(devices) {
    const before = this.#held;
    this.#held = new Map(devices);
    return devices.flatMap(([device, held]) => held.filter((keys) => before.has(device) && !before.get(device).includes(keys)));
  }

  /** Nobody has looked meanwhile. */
  clear() {
    this.#held.clear();
  }
}

/** Which gamepad moves an arm: one that comes to it with its clutch held has to let go first. */
export class Mover {
  #index = null;
  #free = false;

  /** What the arm's gamepad asks for; nothing without one. */
  motion(pad) {
    if ((pad?.index ?? null) !== this.#index) {
      this.#index = pad?.index ?? null;
      this.#free = false;
    }
    if (!pad) return null;
    const motion = padMotion(pad);
    if (!motion.clutch) this.#free = true;
    return { ...motion, clutch: motion.clutch && this.#free };
  }
}

/** A stick beyond its dead zone, finer near its middle. */
function stick(value) {
  const beyond = Math.max(0, Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE);
  return Math.sign(value) * Math.min(1, beyond) ** 2;
}

/** What a gamepad asks for: velocities, and how far the trigger is pressed. */
export function padMotion(pad) {
  const axis = (index) => (Number.isFinite(pad.axes[index]) ? stick(pad.axes[index]) : 0);
  const pressed = (index) => (pad.buttons[index]?.pressed ? 1 : 0);
  return {
    clutch: pressed(4) === 1,
    way: [axis(0) * STICK_M_S, -axis(1) * STICK_M_S, axis(3) * STICK_M_S],
    turn: [
      (pressed(12) - pressed(13)) * STICK_RAD_S,
      (pressed(14) - pressed(15)) * STICK_RAD_S,
      -axis(2) * STICK_RAD_S,
    ],
    trigger: Math.min(1, Math.max(0, pad.buttons[7]?.value ?? 0)),
    other: pressed(3) === 1,
  };
}

/**
 * Drags of the tip in a picture, whose button is the clutch: the way in the view's plane, depth by the wheel; with Shift turns, by the wheel
 * about the line of sight.
 */
export class Drag {
  #way = [0, 0, 0];
  #turn = [0, 0, 0];
  #pointer = null;
  #at = null;

  /** `picture()` is the image that can be dragged, if there is one. */
  constructor(root, picture) {
    root.addEventListener("pointerdown", (event) => {
      if (!this.on || event.target !== picture() || event.button !== 0) return;
      event.preventDefault();
      this.#pointer = event.pointerId;
      this.#at = [event.clientX, event.clientY];
      event.target.setPointerCapture(event.pointerId);
    });
    root.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.#pointer) return;
      const width = Math.max(1, event.target.clientWidth);
      const [dx, dy] = [event.clientX - this.#at[0], event.clientY - this.#at[1]].map((pixels) => pixels / width);
      this.#at = [event.clientX, event.clientY];
      const [to, part] = event.shiftKey ? [this.#turn, [dy * DRAG_RAD, dx * DRAG_RAD]] : [this.#way, [dx, -dy]];
      to[0] += part[0];
      to[1] += part[1];
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      root.addEventListener(end, (event) => {
        if (event.pointerId === this.#pointer) this.clear();
      });
    }
    root.addEventListener("wheel", (event) => {
      if (this.#pointer === null) return;
      event.preventDefault();
      // With Shift some browsers take the wheel for one to the side.
      const clicks = Math.max(-50, Math.min(50, event.deltaY || event.deltaX));
      if (event.shiftKey) this.#turn[2] += clicks * WHEEL_RAD;
      else this.#way[2] += clicks * WHEEL_M;
    }, { passive: false });
    this.on = false;
  }

  get clutch() {
    return this.#pointer !== null;
  }

  clear() {
    this.#pointer = null;
    this.#way = [0, 0, 0];
    this.#turn = [0, 0, 0];
  }

  /** The hand's way, m, and turn, rad, of so many seconds, where the picture is `wide_m` of the hand's way wide. A hand has its pace: what it could not do yet is left. */
  take(wide_m, seconds) {
    const part = (left, unit, most) => {
      const asked = left.map((value, axis) => value * unit[axis]);
      const share = Math.min(1, most / Math.max(1e-9, Math.hypot(...asked)));
      left.forEach((value, axis) => { left[axis] = value * (1 - share); });
      return asked.map((value) => value * share);
    };
    const [most_m, most_rad] = [DRAG_M_S_MAX * seconds, DRAG_RAD_S_MAX * seconds];
    return { way: part(this.#way, [wide_m, wide_m, 1], most_m), turn: part(this.#turn, [1, 1, 1], most_rad) };
  }
}

/** A hand that devices move by velocities; it starts anew at each clutch-in. */
export class VirtualHand {
  clutch = false;
  at = [0, 0, 0];
  turn = [0, 0, 0, 1];
  jaw = 0;

  /** Takes the clutch or lets it go; `jaw` is where the arm's is, 0 to 1. */
  hold(clutch, jaw) {
    if (clutch && !this.clutch) {
      this.at = [0, 0, 0];
      this.turn = [0, 0, 0, 1];
      this.jaw = jaw;
    }
    this.clutch = clutch;
  }

  /** Moves for `seconds`. */
  move({ way, turn }, seconds) {
    if (!this.clutch) return;
    this.at = this.at.map((value, axis) => Math.max(-5, Math.min(5, value + way[axis] * seconds)));
    const angle = Math.hypot(...turn) * seconds;
    if (angle > 1e-9) {
      const sine = (Math.sin(angle / 2) * seconds) / angle;
      this.turn = unit(times([...turn.map((value) => value * sine), Math.cos(angle / 2)], this.turn));
    }
  }

  /** What the run is told. */
  get told() {
    return { clutch: this.clutch, at: this.at.map(rounded), turn: this.turn.map(rounded), jaw: rounded(this.jaw) };
  }
}

/** Six places are a micrometre. */
export const rounded = (value) => Math.round(value * 1e6) / 1e6;

/** The product of two quaternions x, y, z, w. */
function times([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

function unit(quaternion) {
  const norm = Math.hypot(...quaternion);
  return quaternion.map((value) => value / norm);
}
