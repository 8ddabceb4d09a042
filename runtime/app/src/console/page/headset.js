// A headset's controllers as hands, by WebXR: a session in the headset, a picture in front of the viewer, one controller an arm.

import { Presses, rounded } from "./hands.js";

/** At most one message of hands in this time, ms: the run refuses a page that sends more than 400 messages a second, and displays have up to 144 frames. */
const TELL_MS = 11;

/** Which of the page's keys the buttons of controllers are, by xr-standard: A starts, and then keeps; B discards; X does it again; Y hands back. */
const BUTTON_KEYS = { right: [[4, "gy"], [5, "x"]], left: [[4, "z"], [5, "b"]] };
/** A button that is pressed again sooner, ms, is a double press and counts once: A would start an episode and keep it. */
const AGAIN_MS = 1000;
/** How far a thumbstick is pushed before it turns the scene. */
const STICK_DEAD = 0.2;
/** The squeeze. */
const CLUTCH = 1;

const QUAD = {
  vertex: "attribute vec2 at; uniform mat4 clip; varying vec2 uv; void main() { uv = at * vec2(0.5, -0.5) + 0.5; gl_Position = clip * vec4(at * 0.7, -1.4, 1.0); }",
  fragment: "precision mediump float; uniform sampler2D picture; varying vec2 uv; void main() { gl_FragColor = texture2D(picture, uv); }",
};

export class Headset {
  #tell;
  #arms;
  #session = null;
  #space = null;
  #screen = null;
  #offered = false;
  #eyes;
  #more;
  #presses = new Presses();
  #told = -Infinity;
  #before = null;
  #last = { keys: null, at: -Infinity };

  /**
   * `tell(arms)` gets the hands of each frame, `arms()` says how many there are; `eyes.images()` are what the left and the right eye see,
   * `eyes.want(on)` asks for them, `eyes.uploaded(image)` hears what the frame being drawn shows anew; `more.words()` are the lines to read there,
   * `more.scene(canvas)` is what draws the scene for an eye, if it is to be seen there; while no clutch is held `more.turn(x, y, seconds)` hears how a
   * thumbstick turns it, and `more.press(keys)` of a press which of the page's keys it is.
   */
  constructor(tell, arms, eyes, more) {
    this.#tell = tell;
    this.#arms = arms;
    this.#eyes = eyes;
    this.#more = more;
  }

  get running() {
    return this.#session !== null;
  }

  /** Shows the button, and rows of settings, where there is a headset. */
  async offer([button, ...rows], able) {
    if (!this.#offered && navigator.xr) {
      this.#offered = await navigator.xr.isSessionSupported("immersive-vr").catch(() => false);
    }
    for (const node of [button, ...rows]) node.hidden = !this.#offered;
    button.disabled = !able && !this.running;
  }

  async toggle() {
    if (this.#session) {
      await this.#session.end();
      return;
    }
    const session = await navigator.xr.requestSession("immersive-vr");
    this.#session = session;
    session.addEventListener("end", () => this.#ended());
    // Hidden by the headset's own menu, or taken off: hands let go.
    session.addEventListener("visibilitychange", () => {
      if (session.visibilityState === "visible") return;
      this.#presses.clear();
      this.#tell(this.#none());
    });
    this.#space = await session.requestReferenceSpace("local");
    this.#screen = await Screen.open(session).catch(() => null);
    this.#eyes.want(true);
    session.requestAnimationFrame((time, frame) => this.#frame(time, frame));
    document.getElementById("enter-vr-text").textContent = "Leave the headset";
  }

  #ended() {
    this.#session = null;
    this.#before = null;
    this.#told = -Infinity;
    this.#last = { keys: null, at: -Infinity };
    this.#presses.clear();
    this.#screen = null;
    this.#eyes.want(false);
    document.getElementById("enter-vr-text").textContent = "Enter the headset";
    this.#tell(this.#none());
  }

  #none() {
    return Array.from({ length: this.#arms() }, () => null);
  }

  #frame(now, frame) {
    const session = this.#session;
    if (!session) return;
    session.requestAnimationFrame((time, next) => this.#frame(time, next));
    const arms = this.#none();
    for (const source of session.inputSources) {
      const index = this.#armOf(source);
      if (session.visibilityState === "visible" && index < arms.length && source.gripSpace) {
        arms[index] = hand(source, frame.getPose(source.gripSpace, this.#space));
      }
    }
    // On average, so that each frame of a display of 90 Hz tells though some come a little early.
    if (now >= this.#told + TELL_MS) {
      this.#told = Math.max(this.#told + TELL_MS, now - TELL_MS);
      this.#tell(arms);
    }
    if (session.visibilityState === "visible") this.#listen(session.inputSources, now);
    this.#screen?.draw(frame, this.#space, this.#eyes, this.#more);
  }

  /** Buttons and thumbsticks of the controllers, which mean something while no clutch is held. */
  #listen(sources, now) {
    const seconds = Math.min(0.05, (now - (this.#before ?? now)) / 1000);
    this.#before = now;
    const controllers = [...sources].filter(({ handedness, gamepad }) => gamepad && BUTTON_KEYS[handedness]);
    const held = ({ handedness, gamepad }) => BUTTON_KEYS[handedness].filter(([index]) => gamepad.buttons[index]?.pressed).map(([, keys]) => keys);
    const presses = this.#presses.take(controllers.map((source) => [source.handedness, held(source)]));
    if (controllers.some(({ gamepad }) => gamepad.buttons[CLUTCH]?.pressed)) return;
    for (const keys of presses) {
      const again = keys === this.#last.keys && now < this.#last.at + AGAIN_MS;
      this.#last = { keys, at: now };
      if (!again) this.#more.press(keys);
    }
    for (const { gamepad } of controllers) {
      const [x, y] = [2, 3].map((axis) => gamepad.axes?.[axis] ?? 0);
      if (Math.hypot(x, y) > STICK_DEAD) this.#more.turn(x, y, seconds);
    }
  }

  // Of two arms the left hand has the second: psm1 is on the right in the picture. Of one arm the right hand has it.
  #armOf(source) {
    return source.handedness === "right" ? 0 : source.handedness === "left" ? 1 : Infinity;
  }
}

/** What the run is told of a controller: none without a pose that is tracked. */
function hand(source, pose) {
  if (!pose || pose.emulatedPosition) return null;
  const { position, orientation } = pose.transform;
  const buttons = source.gamepad?.buttons ?? [];
  return {
    clutch: Boolean(buttons[CLUTCH]?.pressed),
    tracked: true,
    at: [position.x, position.y, position.z].map(rounded),
    turn: [orientation.x, orientation.y, orientation.z, orientation.w].map(rounded),
    jaw: rounded(Math.min(1, Math.max(0, buttons[0]?.value ?? 0))),
  };
}

/** The lines below the picture: pixels of their texture, and their plane's place and size in that of the picture. */
const LINES = { width: 1024, height: 128, place: new DOMMatrix([1, 0, 0, 0, 0, 0.125, 0, 0, 0, 0, 1, 0, 0, -0.8, 0, 1]) };

/** A picture for each eye, or one for both, on a plane in front of the viewer; lines to read below it. */
class Screen {
  static async open(session) {
    const canvas = document.createElement("canvas");
    const gl = canvas.getContext("webgl2", { xrCompatible: true });
    if (!gl) return null;
    const screen = new Screen(gl);
    screen.layer = new XRWebGLLayer(session, gl);
    await session.updateRenderState({ baseLayer: screen.layer });
    return screen;
  }

  constructor(gl) {
    this.gl = gl;
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, QUAD.vertex], [gl.FRAGMENT_SHADER, QUAD.fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    this.program = program;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    const at = gl.getAttribLocation(program, "at");
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 2, gl.FLOAT, false, 0, 0);
    this.clip = gl.getUniformLocation(program, "clip");
    this.pictures = [0, 1].map(() => ({ texture: gl.createTexture(), shown: null }));
    this.lines = { texture: gl.createTexture(), shown: null, canvas: document.createElement("canvas") };
    [this.lines.canvas.width, this.lines.canvas.height] = [LINES.width, LINES.height];
    for (const { texture } of [...this.pictures, this.lines]) {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    }
  }

  /** Binds the picture of an eye, which `uploaded` hears of if it is new; whether there is one. */
  #bind(eye, image, uploaded) {
    const { gl } = this;
    const picture = this.pictures[eye];
    gl.bindTexture(gl.TEXTURE_2D, picture.texture);
    if (image?.naturalWidth && image.complete && image.src !== picture.shown) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
      picture.shown = image.src;
      uploaded(image);
    }
    return picture.shown !== null;
  }

  /** Binds the lines as they read now. */
  #write(words) {
    const { gl, lines } = this;
    gl.bindTexture(gl.TEXTURE_2D, lines.texture);
    const text = words.join("\n");
    if (text === lines.shown) return;
    const context = lines.canvas.getContext("2d");
    context.fillStyle = "#000";
    context.fillRect(0, 0, LINES.width, LINES.height);
    context.fillStyle = "#fff";
    context.font = "36px sans-serif";
    context.textBaseline = "middle";
    words.forEach((line, index) => context.fillText(line, 16, ((index + 0.5) * LINES.height) / words.length, LINES.width - 32));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, lines.canvas);
    lines.shown = text;
  }

  draw(frame, space, eyes, { words, scene }) {
    const { gl, layer } = this;
    const viewer = frame.getViewerPose(space);
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!viewer) return;
    const paint = scene(gl.canvas);
    const lines = words();
    const images = eyes.images();
    for (const view of viewer.views) {
      const eye = view.eye === "right" && images[1] !== images[0] ? 1 : 0;
      const port = layer.getViewport(view);
      gl.viewport(port.x, port.y, port.width, port.height);
      const clip = new DOMMatrix([...view.projectionMatrix]).multiply(new DOMMatrix([...view.transform.inverse.matrix]));
      if (this.#bind(eye, images[eye], eyes.uploaded)) this.#quad(clip);
      this.#write(lines);
      this.#quad(clip.multiply(LINES.place));
      paint?.(clip, view.transform.position);
    }
  }

  // The scene, which is drawn after it, leaves another program and its own state.
  #quad(clip) {
    const { gl } = this;
    gl.useProgram(this.program);
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.uniformMatrix4fv(this.clip, false, clip.toFloat32Array());
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}
