// The scene in three dimensions: turned by mouse, finger and keys; what the cameras see as frustums, limits as glass.

import { Drawing, eyeMatrix, matrix } from "./scene_draw.js";
import { parsePlaces, parseScene } from "./scene_file.js";

const HOME = { centre: [0, 0, 0.015], turn: -1.1, tilt: 0.55, distance: 0.3 };
const FRUSTUM_M = 0.012;
const PATH_COLOURS = [[0.35, 0.88, 1, 1], [1, 0.89, 0.36, 1]];
const CAMERA_COLOUR = [0.3, 0.9, 1, 1];

/** Where the scene stands in a headset's space, twice as large: in front of the viewer, below the picture, its z upwards. */
const IN_HEADSET = new DOMMatrix().translate(0, -0.8, -0.95).rotate(-90, 0, 0).scale3d(2);
/** How fast a thumbstick that is pushed to its end turns it there, degrees a second, and how far it tilts. */
const STICK_DEG_S = 90;
const TILT_DEG_MAX = 90;

export class Scene {
  #drawing = null;
  /** What draws in a headset, and its canvas. */
  #far = null;
  #nodes = [];
  #cameras = [];
  #paths = [];
  /** The time of the newest places, s; the canvas says it once they are drawn. */
  #seconds;
  #home = HOME;
  #eye = structuredClone(HOME);
  /** How it is turned in a headset, degrees. */
  #stands = { turn: 0, tilt: 0 };
  #turned = false;
  #asked = false;
  #rests = false;
  #want;

  constructor(want) {
    this.#want = want;
    const byId = (id) => document.getElementById(id);
    this.panel = byId("scene");
    this.canvas = byId("scene-view");
    this.show = byId("scene-show");
    this.limits = byId("scene-limits");
    this.vr = byId("scene-vr");
    this.problem = byId("scene-problem");
    this.show.onchange = () => this.#toggle();
    this.limits.onchange = () => this.draw();
    this.vr.onchange = async () => {
      if (this.vr.checked && this.#nodes.length === 0) await this.#load();
      this.#want();
    };
    byId("scene-home").onclick = () => {
      this.#turned = false;
      this.#stands = { turn: 0, tilt: 0 };
      this.#goHome();
    };
    this.#steer();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  /** Whether places are wanted. */
  get wanted() {
    const seen = this.#rests ? this.vr.checked : this.show.checked;
    return seen && this.#nodes.length > 0;
  }

  /** Whoever looks into a headset sees nothing of the page, which leaves the computer to the headset. */
  rest(on) {
    this.#rests = on;
    this.draw();
  }

  /** What draws it in a headset's context with this canvas, given the eye's matrix and place; nothing if it is not to be seen there. */
  inHeadset(canvas) {
    if (!this.vr.checked || this.#nodes.length === 0) return null;
    if (this.#far?.canvas !== canvas) {
      this.#far = { canvas, drawing: new Drawing(canvas) };
      this.#far.drawing.set(this.#nodes);
    }
    const { drawing } = this.#far;
    const { turn, tilt } = this.#stands;
    const { centre } = this.#home;
    const place = IN_HEADSET.translate(...centre).rotateAxisAngle(1, 0, 0, tilt).rotateAxisAngle(0, 0, 1, turn).translate(...centre.map((value) => -value));
    const back = place.inverse();
    return (clip, at) => {
      const { x, y, z } = back.transformPoint(at);
      drawing.paint({ eye: clip.multiply(place).toFloat32Array(), from: [x, y, z], ...this.#seen() });
    };
  }

  /** A thumbstick that is pushed to x, y for so long turns it in the headset: to the side about its vertical, away and nearer about the viewer's x. */
  turnInHeadset(x, y, seconds) {
    const { turn, tilt } = this.#stands;
    const step = STICK_DEG_S * seconds;
    this.#stands = { turn: turn + step * x, tilt: Math.min(TILT_DEG_MAX, Math.max(-TILT_DEG_MAX, tilt + step * y)) };
  }

  /** A run has a scene, or has none. */
  async facts(has) {
    this.panel.hidden = !has;
    if (has && this.show.checked) await this.#load();
  }

  /** Where everything is now. */
  places(buffer, seconds) {
    const { visuals, cameras, bent } = parsePlaces(buffer);
    // Of the file that is on its way.
    if (visuals.length > this.#nodes.length || cameras.length !== this.#cameras.length) return;
    visuals.forEach((pose, index) => (this.#nodes[index].pose = pose));
    cameras.forEach((pose, index) => (this.#cameras[index].pose = pose));
    for (const { index, positions, normals } of bent) {
      for (const drawing of [this.#drawing, this.#far?.drawing]) drawing?.bend(index, positions, normals);
    }
    this.#seconds = seconds.toFixed(3);
    this.#ask();
  }

  /** Where the chunks lead; drawn with the next places, which cost enough. */
  paths(paths) {
    const appears = (paths.length > 0) !== (this.#paths.length > 0);
    this.#paths = paths;
    if (appears) this.#ask();
  }

  draw() {
    this.#ask();
  }

  async #toggle() {
    this.canvas.hidden = !this.show.checked;
    if (this.show.checked) await this.#load();
    this.#want();
  }

  async #load() {
    try {
      const answer = await fetch("/scene.glb");
      if (!answer.ok) throw new Error(`the scene's file: ${answer.status}`);
      this.#drawing ??= new Drawing(this.canvas);
      const nodes = parseScene(await answer.arrayBuffer());
      this.#drawing.set(nodes);
      this.#nodes = nodes;
      // Until their places come it is drawn as the file has it.
      this.#seconds = undefined;
      delete this.canvas.dataset.seconds;
      this.#far?.drawing.set(nodes);
      this.#cameras = nodes.filter((node) => node.kind === "camera");
      this.problem.hidden = true;
      this.#home = home(nodes);
      if (!this.#turned) this.#goHome();
    } catch (error) {
      this.problem.textContent = error.message;
      this.problem.hidden = false;
      this.canvas.hidden = true;
    }
    this.#want();
    this.draw();
  }

  // At most one drawing a frame of the screen.
  #ask() {
    if (this.#asked || this.#rests || !this.#drawing || this.canvas.hidden) return;
    this.#asked = true;
    requestAnimationFrame(() => {
      this.#asked = false;
      this.#paint();
    });
  }

  #paint() {
    const scale = Math.min(devicePixelRatio, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((size) => Math.max(1, Math.round(size * scale)));
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    const { centre, turn, tilt, distance } = this.#eye;
    const away = [Math.cos(tilt) * Math.cos(turn), Math.cos(tilt) * Math.sin(turn), Math.sin(tilt)];
    const from = centre.map((value, axis) => value + distance * away[axis]);
    this.#drawing.draw({ ...eyeMatrix(from, centre, width / height), from, width, height, background: [0.09, 0.11, 0.13], ...this.#seen() });
    if (this.#seconds !== undefined) this.canvas.dataset.seconds = this.#seconds;
    this.canvas.dataset.paths = this.#paths.reduce((sum, { points }) => sum + points.length, 0);
    this.canvas.dataset.drawn = Number(this.canvas.dataset.drawn ?? 0) + 1;
  }

  /** Which nodes are seen, and the lines. */
  #seen() {
    const limits = this.limits.checked;
    return {
      visible: (node) => limits || node.kind === "thing",
      lines: [
        ...this.#cameras.map((camera) => ({ points: frustum(camera), colour: CAMERA_COLOUR })),
        ...this.#paths.map(({ points }, arm) => ({ points: pairs(points), colour: PATH_COLOURS[arm], over: true })),
      ],
    };
  }

  #steer() {
    const canvas = this.canvas;
    const held = new Map();
    canvas.onpointerdown = (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    };
    canvas.onpointerup = canvas.onpointercancel = (event) => held.delete(event.pointerId);
    canvas.oncontextmenu = (event) => event.preventDefault();
    canvas.onpointermove = (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      if (held.size === 2) {
        const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
        this.#zoom(apart(before) / Math.max(1, apart([event.clientX, event.clientY])));
      } else if (event.buttons & 2 || event.shiftKey) this.#pan(dx, dy);
      else this.#turn(-0.008 * dx, 0.008 * dy);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    };
    canvas.onwheel = (event) => {
      event.preventDefault();
      this.#zoom(Math.exp(0.001 * event.deltaY));
    };
    const keys = {
      ArrowLeft: () => this.#turn(0.1, 0), ArrowRight: () => this.#turn(-0.1, 0),
      ArrowUp: () => this.#turn(0, 0.1), ArrowDown: () => this.#turn(0, -0.1),
      PageUp: () => this.#zoom(0.9), PageDown: () => this.#zoom(1.1),
    };
    canvas.onkeydown = (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      event.stopPropagation();
      keys[event.key]();
    };
  }

  #goHome() {
    this.#eye = structuredClone(this.#home);
    this.draw();
  }

  #turn(turn, tilt) {
    this.#turned = true;
    this.#eye.turn += turn;
    this.#eye.tilt = Math.min(1.5, Math.max(-1.5, this.#eye.tilt + tilt));
    this.draw();
  }

  #zoom(factor) {
    this.#turned = true;
    this.#eye.distance = Math.min(1.5, Math.max(0.03, this.#eye.distance * factor));
    this.draw();
  }

  #pan(dx, dy) {
    this.#turned = true;
    const { turn, tilt, distance } = this.#eye;
    const step = (0.73 * distance) / this.canvas.clientHeight;
    const right = [-Math.sin(turn), Math.cos(turn), 0];
    const up = [-Math.sin(tilt) * Math.cos(turn), -Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)];
    this.#eye.centre = this.#eye.centre.map((value, axis) => value + step * (dy * up[axis] - dx * right[axis]));
    this.draw();
  }
}

/** Where the eye looks at first. A robot may have its scene frame anywhere: then it looks at the middle of the workspaces. */
function home(nodes) {
  const ranges = (positions) => [0, 1, 2].map((axis) => {
    const along = positions.filter((_, index) => index % 3 === axis);
    return [Math.min(...along), Math.max(...along)];
  });
  const spaces = nodes.filter(({ kind }) => kind === "workspace").map(({ mesh }) => ranges([...mesh.positions]));
  const holds = (space) => space.every(([low, high], axis) => low <= HOME.centre[axis] && HOME.centre[axis] <= high);
  if (spaces.length === 0 || spaces.some(holds)) return HOME;
  const all = [0, 1, 2].map((axis) => [Math.min(...spaces.map((space) => space[axis][0])), Math.max(...spaces.map((space) => space[axis][1]))]);
  const across = Math.hypot(...all.map(([low, high]) => high - low));
  return { ...HOME, centre: all.map(([low, high]) => (low + high) / 2), distance: Math.min(1.5, Math.max(HOME.distance, 1.5 * across)) };
}

/** A line through points as the ends of its pieces. */
const pairs = (points) => points.slice(1).flatMap((point, index) => [points[index], point]);

/** The edges of what a camera sees, as pairs of points: it looks along z, y is down. */
function frustum({ camera, pose }) {
  const place = matrix(pose);
  const world = ([x, y, z]) => [0, 1, 2].map((axis) => place[axis] * x + place[4 + axis] * y + place[8 + axis] * z + place[12 + axis]);
  const half = FRUSTUM_M * Math.tan(camera.yfov / 2);
  const wide = half * camera.aspectRatio;
  const corners = [[-wide, -half], [wide, -half], [wide, half], [-wide, half]].map(([x, y]) => world([x, y, FRUSTUM_M]));
  const apex = world([0, 0, 0]);
  const roof = world([0, -1.5 * half, FRUSTUM_M]);
  return corners.flatMap((corner, index) => [apex, corner, corner, corners[(index + 1) % 4]]).concat([corners[0], roof, roof, corners[1]]);
}
