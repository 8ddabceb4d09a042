// A scripted operator: it hears what the page hears, and moves a device that is not there. Axes are the picture's.

window.WebSocket = class extends WebSocket {
  constructor(...where) {
    super(...where);
    this.addEventListener("message", ({ data }) => {
      const told = typeof data === "string" ? JSON.parse(data) : null;
      if (told?.kind === "state") window.told = told;
    });
  }

  send(message) {
    super.send(message);
    if (message.startsWith('{"hands"')) window.handsTold += 1;
    if (message.startsWith('{"shown"')) window.shown[window.headsetDraws ? "headset" : "page"] += 1;
  }
};

/** How often the run was told of a picture that is shown: from within a frame of the headset, and otherwise. */
window.shown = { headset: 0, page: 0 };

/** How often the run was told of hands. */
window.handsTold = 0;

/** How often the page has looked at its gamepads, or at the controllers of a headset. */
window.looks = 0;

/** A frame of the headset. */
function drawn(frame) {
  window.headsetDraws = true;
  try {
    frame();
    window.looks += 1;
  } finally {
    window.headsetDraws = false;
  }
}

/** What was written for the headset, whose lines are the only text that is drawn. */
window.written = new Set();
const fillText = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function write(text, ...where) {
  window.written.add(text);
  return fillText.call(this, text, ...where);
};

const SCALE = 0.4;

/** The turn from one quaternion x, y, z, w to another, as a rotation vector. */
function turnBetween([ax, ay, az, aw], [bx, by, bz, bw]) {
  const [x, y, z, w] = [
    bw * -ax + bx * aw + by * -az - bz * -ay,
    bw * -ay - bx * -az + by * aw + bz * -ax,
    bw * -az + bx * -ay - by * -ax + bz * aw,
    bw * aw + bx * ax + by * ay + bz * az,
  ];
  const side = w < 0 ? -1 : 1;
  const sine = Math.hypot(x, y, z);
  const angle = 2 * Math.atan2(sine, Math.abs(w));
  return sine < 1e-9 ? [0, 0, 0] : [x, y, z].map((value) => (side * value * angle) / sine);
}

/** The product of two quaternions x, y, z, w. */
function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** A gamepad of the standard mapping. Sticks are pushed to where the tip goes as fast as `rate` says; the cross turns. */
class Gamepad {
  rate = { way: 0.0134, turn: [1.0, 1.0, 0.28] };
  pad = {
    connected: true, mapping: "standard", axes: [0, 0, 0, 0],
    buttons: Array.from({ length: 17 }, () => ({ pressed: false, value: 0 })),
  };

  /** Start, A, Select, B and RB. */
  says = { start: 9, keep: 0, redo: 8, discard: 1, handBack: 5 };

  constructor() {
    navigator.getGamepads = () => {
      window.looks += 1;
      return [null, this.pad];
    };
  }

  say(what, on) { this.press(this.says[what], on); }

  press(index, on) {
    this.pad.buttons[index] = { pressed: Boolean(on), value: Number(on) };
  }

  hold(on) { this.press(4, on); }
  jaw(closed) { this.press(7, closed); }

  /** Each number is a direction: -1, 0 or 1. */
  drive(way, turn) {
    const stick = 0.6;
    this.pad.axes = [way[0] * stick, -way[1] * stick, -turn[2] * stick, way[2] * stick];
    this.press(12, turn[0] > 0);
    this.press(13, turn[0] < 0);
    this.press(14, turn[1] > 0);
    this.press(15, turn[1] < 0);
  }

  time(axis, amount) {
    return amount / (axis < 3 ? this.rate.way : this.rate.turn[axis - 3]);
  }
}

/** A keyboard: what is held is told as events. */
class Keys {
  down = new Set();
  pairs = [
    ["ArrowRight", "ArrowLeft"], ["ArrowUp", "ArrowDown"], ["PageDown", "PageUp"],
    ["KeyI", "KeyK"], ["KeyJ", "KeyL"], ["KeyU", "KeyO"],
  ];

  set(code, on) {
    if (this.down.has(code) === on) return;
    this.down[on ? "add" : "delete"](code);
    const key = code.startsWith("Key") ? code.slice(3).toLowerCase() : code;
    document.body.dispatchEvent(new KeyboardEvent(on ? "keydown" : "keyup", { code, key, bubbles: true, cancelable: true }));
  }

  hold(on) { this.set("KeyF", on); }

  jaw(closed) {
    const now = window.told.teleop.arms[0].jaw;
    this.set("KeyM", closed > now + 0.05);
    this.set("KeyN", closed < now - 0.05);
  }

  drive(way, turn) {
    [...way, ...turn].forEach((sign, axis) => {
      this.set(this.pairs[axis][0], sign > 0);
      this.set(this.pairs[axis][1], sign < 0);
    });
  }

  // The pace grows while a key is held: rate * (0.2 t + t^2).
  time(axis, amount) {
    const rate = axis < 3 ? 0.1 * SCALE : 0.8;
    return Math.sqrt(0.01 + amount / rate) - 0.1;
  }
}

/** Two eyes at one place, for which the picture fills what they see. */
const EYES = ["left", "right"].map((eye) => ({
  eye,
  projectionMatrix: [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, -1, -1, 0, 0, -0.1, 0],
  transform: { inverse: { matrix: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] } },
}));
const EYE_PIXELS = 256;
/** The part of what is drawn that is below the picture and its lines. */
const BELOW = 0.3;
let layer = null;

/** The left eye's picture beside the right one's. */
class Layer {
  framebuffer = null;

  constructor(session, gl) {
    this.gl = gl;
    [gl.canvas.width, gl.canvas.height] = [2 * EYE_PIXELS, EYE_PIXELS];
    layer = this;
  }

  getViewport({ eye }) {
    return { x: eye === "right" ? EYE_PIXELS : 0, y: 0, width: EYE_PIXELS, height: EYE_PIXELS };
  }
}

/** Which shares of the pixels the eyes see otherwise, and not black, and not black below: the left half of what is drawn, and the right one. */
function compareEyes(gl) {
  const { drawingBufferWidth: both, drawingBufferHeight: height } = gl;
  const width = both / 2;
  const [left, right] = [0, width].map((x) => {
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(x, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return pixels;
  });
  let [other, lit, below] = [0, 0, 0];
  for (let at = 0; at < left.length; at += 4) {
    const channels = [0, 1, 2].map((channel) => at + channel);
    if (channels.some((at) => Math.abs(left[at] - right[at]) > 24)) other += 1;
    if (!channels.some((at) => right[at] > 24)) continue;
    lit += 1;
    // Rows are read from the lowest on.
    if (at < left.length * BELOW) below += 1;
  }
  window.operator.seen = [other, lit, below].map((count) => count / (width * height));
}

/** A hand's controller, which moves as it is driven. */
class Controller {
  turn = [0, 0, 0, 1];
  /** By xr-standard: trigger, squeeze, no touchpad, thumbstick, A or X, B or Y. */
  buttons = Array.from({ length: 6 }, () => ({ value: 0, pressed: false }));
  axes = [0, 0, 0, 0];
  rate = 0.013 / SCALE;

  constructor(handedness) {
    this.at = [handedness === "right" ? 0.2 : -0.2, 1.1, -0.3];
    this.source = { handedness, targetRayMode: "tracked-pointer", gripSpace: this, gamepad: this };
  }

  go(seconds) {
    const time = seconds / window.operator.pace;
    this.at = this.at.map((value, axis) => value + (this.moving?.[0][axis] ?? 0) * this.rate * time);
    const [x, y, z] = this.moving?.[1].map((value) => (value * 0.3 * time) / 2) ?? [0, 0, 0];
    const turned = product([x, y, z, 1], this.turn);
    this.turn = turned.map((value) => value / Math.hypot(...turned));
  }

  get transform() {
    const [x, y, z] = this.at;
    const [a, b, c, w] = this.turn;
    return { position: { x, y, z }, orientation: { x: a, y: b, z: c, w } };
  }

  press(index, on) { this.buttons[index] = { value: Number(on), pressed: on }; }
  hold(on) { this.press(1, on); }
  jaw(closed) { this.buttons[0] = { value: closed, pressed: closed > 0.5 }; }
  drive(way, turn) { this.moving = [way, turn]; }
  time(axis, amount) { return (amount * window.operator.pace) / (axis < 3 ? 0.013 : 0.3); }

  /** Held as the instrument with this tip points, and turned from there by an angle, rad, about the picture's x. */
  align(tip, angle = 0) {
    const held = product(tip.slice(3), [-1, 0, 0, 0]);
    this.turn = product([Math.sin(angle / 2), 0, 0, Math.cos(angle / 2)], held);
  }
}

/** What the buttons of the right and the left controller say: A, A once more, B, X and Y. */
const SAYS = { start: [0, 4], keep: [0, 4], discard: [0, 5], redo: [1, 4], handBack: [1, 5] };

function sayBy(controllers, what, on) {
  const [hand, button] = SAYS[what];
  controllers[hand].press(button, on);
}

/** A headset with two controllers. */
class Headset {
  controllers = ["right", "left"].map((handedness) => new Controller(handedness));

  constructor() {
    const { controllers } = this;
    window.XRWebGLLayer = Layer;
    class Session extends EventTarget {
      visibilityState = "visible";
      inputSources = controllers.map(({ source }) => source);
      requestReferenceSpace() { return Promise.resolve({}); }
      updateRenderState() {}
      time = 0;
      requestAnimationFrame(frame) {
        const pose = ({ transform }) => window.operator.tracked && { emulatedPosition: false, transform };
        return setTimeout(() => {
          const viewer = () => (window.operator.eyes ? { views: EYES } : null);
          this.time += 1000 / window.operator.hz;
          drawn(() => frame(this.time, { getPose: pose, getViewerPose: viewer }));
          if (window.operator.eyes && window.operator.compares) compareEyes(layer.gl);
        }, 14);
      }
      async end() { this.dispatchEvent(new Event("end")); }
    }
    Object.defineProperty(navigator, "xr", { value: {
      isSessionSupported: (mode) => Promise.resolve(mode === "immersive-vr"),
      requestSession: () => Promise.resolve(new Session()),
    } });
    let before = performance.now();
    setInterval(() => {
      const now = performance.now();
      const seconds = Math.min(0.05, (now - before) / 1000);
      before = now;
      controllers.forEach((controller) => controller.go(seconds));
    }, 10);
  }

  say(what, on) { sayBy(this.controllers, what, on); }
}

/** The rotation of a matrix by columns, of less than half a turn, as a quaternion x, y, z, w. */
function rotationOf(m) {
  const w = Math.sqrt(1 + m[0] + m[5] + m[10]) / 2;
  return [m[6] - m[9], m[8] - m[2], m[1] - m[4]].map((value) => value / (4 * w)).concat(w);
}

/** Meta's emulation of a Quest 3 (IWER), whose controllers' grips are where the hands are. */
class Emulated {
  controllers = ["right", "left"].map((handedness) => new Controller(handedness));
  quest = new IWER.XRDevice(IWER.metaQuest3, { stereoEnabled: true });

  constructor() {
    // Chromium has a navigator.xr, without a device.
    this.quest.installRuntime({ forceInstall: true });
    // It calls all positions estimated, which those of tracked controllers are not.
    Object.defineProperty(XRPose.prototype, "emulatedPosition", { get: () => !window.operator.tracked });
    const ask = XRSession.prototype.requestAnimationFrame;
    XRSession.prototype.requestAnimationFrame = function request(callback) {
      return ask.call(this, (time, frame) => {
        drawn(() => callback(time, frame));
        if (window.operator.eyes && window.operator.compares) compareEyes(this.renderState.baseLayer.context);
      });
    };
    let before = performance.now();
    setInterval(() => {
      const now = performance.now();
      const seconds = Math.min(0.05, (now - before) / 1000);
      before = now;
      for (const controller of this.controllers) {
        controller.go(seconds);
        this.#place(controller);
      }
    }, 10);
  }

  say(what, on) { sayBy(this.controllers, what, on); }

  /** It places where a controller points from; the grip is elsewhere. */
  #place({ at, turn, buttons, axes, source: { handedness } }) {
    const controller = this.quest.controllers[handedness];
    const offset = IWER.metaQuest3.controllerConfig.layout[handedness].gripOffsetMatrix;
    const [a, b, c, w] = rotationOf(offset);
    const pointing = product(turn, [-a, -b, -c, w]);
    const lever = product(product(pointing, [...offset.slice(12, 15), 0]), [...pointing.slice(0, 3).map((value) => -value), pointing[3]]);
    controller.position.set(...at.map((value, axis) => value - lever[axis]));
    controller.quaternion.set(...pointing);
    const names = ["trigger", "squeeze", null, null, ...(handedness === "right" ? ["a-button", "b-button"] : ["x-button", "y-button"])];
    names.forEach((name, index) => name && controller.updateButtonValue(name, buttons[index].value));
    controller.updateAxes("thumbstick", axes[2], axes[3]);
  }
}

/** A SpaceMouse: two thirds of its way while it is driven, a report of its buttons when they change. */
class Cap {
  driven = [0, 0, 0, 0, 0, 0];
  buttons = 0;
  combined = false;
  device = { vendorId: 0x256f, opened: false, oninputreport: null, open: async () => { this.device.opened = true; } };

  constructor() {
    this.hid = Object.assign(new EventTarget(), {
      getDevices: async () => [],
      requestDevice: async ({ filters }) => (filters.some(({ vendorId }) => vendorId === this.device.vendorId) ? [this.device] : []),
    });
    Object.defineProperty(navigator, "hid", { value: this.hid });
    setInterval(() => {
      if (this.driven.every((value) => value === 0)) return;
      if (this.combined) this.report(1, this.driven);
      else for (const half of [0, 3]) this.report(1 + half / 3, this.driven.slice(half, half + 3));
    }, 10);
  }

  report(reportId, values) {
    const data = new DataView(new ArrayBuffer(2 * values.length));
    values.forEach((value, place) => data.setInt16(2 * place, value, true));
    this.device.oninputreport?.({ reportId, data });
  }

  press(button, on) {
    this.buttons = on ? this.buttons | button : this.buttons & ~button;
    this.report(3, [this.buttons]);
  }

  hold(on) { this.press(1, on); }
  second() { [true, false].forEach((on) => this.press(2, on)); }

  /** The device's axes are x to the right, y towards the person, z down. */
  drive(way, turn) {
    const before = this.driven;
    this.driven = [way, turn].flatMap(([x, y, z]) => [x, z, -y].map((value) => 230 * value));
    if (before.some((value) => value !== 0)) [1, 2].forEach((id) => this.report(id, [0, 0, 0]));
  }

  unplug() {
    this.driven = [0, 0, 0, 0, 0, 0];
    this.hid.dispatchEvent(Object.assign(new Event("disconnect"), { device: this.device }));
  }
}

const DEVICES = { keyboard: Keys, gamepad: Gamepad, spacemouse: Cap, headset: Headset, iwer: Emulated };
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Looks where the tip is, moves towards where it should be for as long as that takes, and looks again. */
window.operator = {
  tracked: true,
  /** Whether a headset shows anything, and whether what its eyes see is compared. */
  eyes: false,
  compares: true,
  /** Frames of a headset's display in a second of its time. */
  hz: 72,
  /** How many times slower than a run in threefold slow motion wants it a controller is moved, and waited for. */
  pace: 1,
  moves: false,
  there: false,
  done: false,
  /** The arms whose clutches are held, and the one that is moved. */
  arms: [0],
  arm: 0,
  get device() {
    // A mouse is the browser's own.
    return (this.made ??= DEVICES[window.device] && new DEVICES[window.device]());
  },
  get hands() { return this.hand(this.arm); },
  hand(arm) { return this.device?.controllers?.[arm] ?? this.device; },
  get told() { return window.told.teleop.arms[this.arm]; },
  hold(on) { for (const arm of this.arms) this.hand(arm).hold(on); },
  /** Waits until the page has looked at its device so many times more. */
  async looked(times) {
    const before = window.looks;
    while (window.looks < before + times) await sleep(10);
  },
  /** Presses the device's button that says so, or lets it go, and waits until the page has done whatever it makes of it. */
  async say(what, on) {
    this.device.say(what, on);
    await this.looked(3);
  },
  push(way) { this.hands.drive(way, [0, 0, 0]); },
  /** Controllers are held as their instruments point. */
  align() { for (const arm of this.arms) this.hand(arm).align?.(window.told.teleop.arms[arm].tip); },

  /** Holds the clutches until the arms follow; one that the run let go of, as it does when the hand comes late, is taken anew. */
  async take() {
    const arms = () => this.arms.map((arm) => window.told.teleop.arms[arm]);
    while (!arms().every((arm) => arm.engaged)) {
      this.hold(false);
      while (arms().some((arm) => arm.lost !== null || arm.engaged)) await sleep(20);
      this.align();
      this.hold(true);
      while (!arms().every((arm) => arm.engaged) && arms().every((arm) => arm.lost === null)) await sleep(20);
    }
  },

  /** Holds the clutch with the controller turned away from its instrument by an angle, rad, until the run says so. */
  async misalign(angle) {
    do {
      this.hold(false);
      while (this.told.lost !== null || this.told.engaged || this.told.misaligned_deg !== null) await sleep(20);
      this.hands.align(this.told.tip, angle);
      this.hold(true);
      while (this.told.lost === null && this.told.misaligned_deg === null) await sleep(20);
    } while (this.told.lost !== null);
  },

  /** Takes the clutch and pushes until the arm moves. */
  async move(way) {
    this.moves = false;
    while (!this.moves) {
      await this.take();
      this.push(way);
      await sleep(20);
      this.moves = window.told.arms[this.arm].commanded_velocity.some((v) => Math.abs(v) > 0.01);
    }
  },

  /** Controllers are no longer tracked while they move the arm; a loss of another cause before is none. */
  async lose(way) {
    do {
      this.tracked = true;
      await this.move(way);
      this.tracked = false;
      while (this.told.lost === null) await sleep(20);
    } while (!this.told.lost.includes("device disconnected"));
  },

  /** Takes the clutch and pushes until `fits`, however often the run lets go of it meanwhile; then holds still. */
  async until(way, turn, fits) {
    this.there = false;
    while (!fits()) {
      await this.take();
      this.hands.drive(way, turn);
      await sleep(20);
    }
    this.hands.drive([0, 0, 0], [0, 0, 0]);
    this.there = true;
  },

  rest() {
    for (const arm of this.arms) this.hand(arm).drive([0, 0, 0], [0, 0, 0]);
    this.hold(false);
  },

  /**
   * Goes to each place of the way with the arm that is to be there, within m and rad, and closes its jaw so far; the others' hands stay
   * where they are.
   */
  async follow(way, within = [0.0007, 0.05]) {
    this.done = false;
    this.within = within;
    for (const arm of this.arms) this.hand(arm).drive([0, 0, 0], [0, 0, 0]);
    await sleep(300);
    // The trigger meets the jaw on its way.
    for (const { arm = 0, tip, jaw } of way) {
      this.arm = arm;
      while (await this.approach(tip));
      await this.close(jaw);
    }
    this.done = true;
  },

  /** One look and the move that it asks for; whether there was one. */
  async approach(goal) {
    await this.take();
    const { tip } = this.told;
    if (!tip) return true;
    const errors = [
      ...[0, 1, 2].map((axis) => goal[axis] - tip[axis]),
      ...turnBetween(tip.slice(3), goal.slice(3)),
    ];
    const close = errors.map((error, axis) => Math.abs(error) < this.within[axis < 3 ? 0 : 1]);
    if (close.every(Boolean)) return false;
    const times = errors.map((error, axis) => (close[axis] ? 0 : Math.min(1.5 * this.pace, this.hands.time(axis, Math.abs(error)))));
    const begin = performance.now();
    for (let elapsed = 0; elapsed < Math.max(...times); elapsed = (performance.now() - begin) / 1000) {
      const signs = errors.map((error, axis) => (times[axis] > elapsed ? Math.sign(error) : 0));
      this.hands.drive(signs.slice(0, 3), signs.slice(3));
      await sleep(10);
    }
    this.hands.drive([0, 0, 0], [0, 0, 0]);
    await sleep(900 * this.pace);
    return true;
  },

  async close(jaw) {
    let far = Math.abs(this.told.jaw - jaw) > 0.03;
    for (let tries = 0; far; tries += 1) {
      await this.take();
      if (window.device !== "keyboard" && (jaw === 0 || tries > 0)) {
        // Through the jaw's angle and back: from there it follows.
        this.hands.jaw(1 - jaw);
        await sleep(200 * this.pace);
      }
      for (let looks = 0; looks < 60; looks += 1) {
        this.hands.jaw(jaw);
        await sleep(50 * this.pace);
      }
      far = Math.abs(this.told.jaw - jaw) > 0.1;
    }
    if (window.device === "keyboard") for (const code of ["KeyM", "KeyN"]) this.hands.set(code, false);
  },
};
setTimeout(() => window.operator.device);
