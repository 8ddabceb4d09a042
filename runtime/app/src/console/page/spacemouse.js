// A SpaceMouse by WebHID: a cap with six axes, and buttons. The first button is the clutch, the second one closes the jaw, or opens it again.

import { still } from "./hands.js";

/** 3Dconnexion, and from before Logitech: controllers of many axes. */
const FILTERS = [0x256f, 0x046d].map((vendorId) => ({ vendorId, usagePage: 1, usage: 8 }));
const CLUTCH = 1;
const JAW = 2;

/** What the cap tells when it is pushed as far as it goes, and what it tells of a hand that only rests on it. */
const FULL = 350;
const IDLE = 10;

// Of a hand: the tip makes a part of the way.
const CAP_M_S = 0.12;
const CAP_RAD_S = 1.0;
const CAP_JAW_1_S = 1.2;

/** While it is pushed it tells so a hundred times a second. */
const SILENT_MS = 200;

/** Whether this browser can have one. */
export const canConnect = () => Boolean(navigator.hid);

export class SpaceMouse {
  #device = null;
  #way = [0, 0, 0];
  #turn = [0, 0, 0];
  #told = -Infinity;
  #buttons = 0;
  #clutch = false;
  #flip = false;
  #closing = 0;

  constructor() {
    navigator.hid?.addEventListener("disconnect", ({ device }) => {
      if (device !== this.#device) return;
      this.#device = null;
      this.clear();
    });
  }

  get connected() {
    return this.#device !== null;
  }

  /** Asks the person which one it is, as a click only can, if none was chosen before. */
  async connect() {
    const known = (await navigator.hid.getDevices()).filter(({ vendorId }) => FILTERS.some((filter) => filter.vendorId === vendorId));
    const [device] = known.length > 0 ? known : await navigator.hid.requestDevice({ filters: FILTERS });
    if (!device || device === this.#device) return;
    if (!device.opened) await device.open();
    device.oninputreport = (event) => device === this.#device && this.#report(event);
    this.clear();
    this.#device = device;
  }

  /** As if its buttons were let go: they have to be pressed anew. */
  clear() {
    this.#clutch = false;
    this.#closing = 0;
    this.#told = -Infinity;
  }

  get clutch() {
    return this.#clutch;
  }

  /** The velocities that it asks for at `now`, ms; the jaw is closed so far, 0 to 1. */
  motion(now, jaw) {
    const asked = still();
    if (!this.#device) return asked;
    if (this.#flip) this.#closing = jaw < 0.5 ? 1 : -1;
    this.#flip = false;
    asked.clutch = this.#clutch;
    asked.jaw = this.#clutch ? this.#closing * CAP_JAW_1_S : 0;
    if (now - this.#told > SILENT_MS) return asked;
    asked.way = axes(this.#way, CAP_M_S);
    asked.turn = axes(this.#turn, CAP_RAD_S);
    return asked;
  }

  #report({ reportId, data }) {
    const three = (at) => [0, 2, 4].map((more) => data.getInt16(at + more, true));
    if (reportId === 3 && data.byteLength > 0) this.#press(data.getUint8(0));
    else if (reportId === 2 && data.byteLength >= 6) this.#turn = three(0);
    else if (reportId === 1 && data.byteLength >= 6) {
      this.#way = three(0);
      // Newer ones tell all six at once.
      if (data.byteLength >= 12) this.#turn = three(6);
    } else return;
    if (reportId !== 3) this.#told = performance.now();
  }

  #press(buttons) {
    const pressed = buttons & ~this.#buttons;
    this.#buttons = buttons;
    if (pressed & CLUTCH) this.#clutch = true;
    if (!(buttons & CLUTCH)) {
      this.#clutch = false;
      this.#closing = 0;
    }
    if (pressed & JAW) this.#flip = this.#clutch;
  }
}

/** The device's axes, x to the right, y towards the person, z down, in the picture's: finer near the middle. */
function axes([x, y, z], full) {
  return [x, -z, y].map((value) => {
    const beyond = Math.max(0, Math.abs(value) - IDLE) / (FULL - IDLE);
    return Math.sign(value) * Math.min(1, beyond) ** 2 * full;
  });
}
