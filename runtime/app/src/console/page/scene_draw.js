// Draws a scene with WebGL 2: solid things, then what one sees through, then lines.

const VERTEX = `#version 300 es
uniform mat4 eye; uniform mat4 place;
in vec3 position; in vec3 normal;
out vec3 at; out vec3 up;
void main() {
  vec4 world = place * vec4(position, 1.0);
  at = world.xyz; up = mat3(place) * normal;
  gl_Position = eye * world;
}`;

// One lamp at the eye and a sky, so that every side is seen; shapes matter here, not looks.
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 colour; uniform vec3 from; uniform float metallic; uniform float flat_;
in vec3 at; in vec3 up;
out vec4 seen;
void main() {
  vec3 base = colour.rgb;
  if (flat_ < 0.5) {
    vec3 n = normalize(up); vec3 v = normalize(from - at);
    if (dot(n, v) < 0.0) n = -n;
    float lamp = max(dot(n, v), 0.0);
    float sky = 0.5 + 0.5 * n.z;
    float shine = pow(lamp, mix(24.0, 60.0, metallic)) * mix(0.06, 0.35, metallic);
    base = base * (0.25 + 0.75 * lamp + 0.25 * sky) * mix(1.0, 0.75, metallic) + shine;
  }
  // Materials are as dark as in a body, under a lamp a hand away.
  vec3 lit = flat_ < 0.5 ? 1.0 - exp(-2.6 * base) : base;
  seen = vec4(pow(lit, vec3(1.0 / 2.2)), colour.a);
}`;

/** A column-major matrix of the pose [x, y, z, qx, qy, qz, qw]. */
export function matrix([x, y, z, a, b, c, w]) {
  return [
    1 - 2 * (b * b + c * c), 2 * (a * b + c * w), 2 * (a * c - b * w), 0,
    2 * (a * b - c * w), 1 - 2 * (a * a + c * c), 2 * (b * c + a * w), 0,
    2 * (a * c + b * w), 2 * (b * c - a * w), 1 - 2 * (a * a + b * b), 0,
    x, y, z, 1,
  ];
}

const IDENTITY = matrix([0, 0, 0, 0, 0, 0, 1]);

function times(a, b) {
  const product = new Array(16).fill(0);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++)
      for (let k = 0; k < 4; k++) product[4 * column + row] += a[4 * k + row] * b[4 * column + k];
  return product;
}

const minus = (a, b) => a.map((v, i) => v - b[i]);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
const unit = (a) => a.map((v) => v / Math.hypot(...a));

/** From the world to the image of an eye at `from` that looks at `to`. */
export function eyeMatrix(from, to, aspect) {
  const back = unit(minus(from, to));
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  const view = [
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, from), -dot(up, from), -dot(back, from), 1,
  ];
  const [near, far, f] = [0.002, 3, 1 / Math.tan(0.35)];
  const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
  return { eye: times(lens, view), right, up };
}

export class Drawing {
  #gl;
  #program;
  #uniforms = {};
  #shapes = [];

  /** Throws if this browser has no WebGL 2. */
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.#gl = gl;
    this.#program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(this.#program, shader);
    }
    gl.bindAttribLocation(this.#program, 0, "position");
    gl.bindAttribLocation(this.#program, 1, "normal");
    gl.linkProgram(this.#program);
    if (!gl.getProgramParameter(this.#program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.#program) ?? "no shader");
    for (const name of ["eye", "place", "colour", "from", "metallic", "flat_"]) this.#uniforms[name] = gl.getUniformLocation(this.#program, name);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Uploads nodes of a scene's file; those without a mesh are not drawn. */
  set(nodes) {
    for (const shape of this.#shapes) this.#gl.deleteVertexArray(shape?.array ?? null);
    this.#shapes = nodes.map((node) => node.mesh && this.#upload(node));
  }

  /** Gives a node another shape with as many vertices. */
  bend(index, positions, normals) {
    const [gl, shape] = [this.#gl, this.#shapes[index]];
    if (!shape) return;
    for (const [buffer, numbers] of [[shape.positions, positions], [shape.normals, normals]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.DYNAMIC_DRAW);
    }
  }

  /** Draws an image of this size. */
  draw({ width, height, background, ...seen }) {
    const gl = this.#gl;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.paint(seen);
  }

  /** Draws what `visible(node)` lets, seen from `from`; `lines` are further lines as { points, colour, over }: over everything or not. */
  paint({ eye, from, visible, lines }) {
    const gl = this.#gl;
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.#program);
    gl.uniformMatrix4fv(this.#uniforms.eye, false, eye);
    gl.uniform3fv(this.#uniforms.from, from);
    const shapes = this.#shapes.filter((shape) => shape && visible(shape.node));
    const clear = (shape) => shape.node.colour[3] < 1 && !shape.lines;
    gl.disable(gl.BLEND);
    for (const shape of shapes.filter((shape) => !clear(shape))) this.#draw(shape);
    this.#lines(lines);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const shape of shapes.filter(clear)) this.#draw(shape);
    gl.depthMask(true);
  }

  #draw(shape) {
    const [gl, at] = [this.#gl, this.#uniforms];
    gl.uniformMatrix4fv(at.place, false, matrix(shape.node.pose));
    gl.uniform4fv(at.colour, shape.node.colour);
    gl.uniform1f(at.metallic, shape.node.metallic ?? 0);
    gl.uniform1f(at.flat_, shape.lines ? 1 : 0);
    gl.bindVertexArray(shape.array);
    if (shape.lines) gl.drawArrays(gl.LINES, 0, shape.count);
    else gl.drawElements(gl.TRIANGLES, shape.count, gl.UNSIGNED_INT, 0);
  }

  #lines(lines) {
    const [gl, at] = [this.#gl, this.#uniforms];
    this.loose ??= { array: gl.createVertexArray(), buffer: gl.createBuffer() };
    gl.bindVertexArray(this.loose.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.loose.buffer);
    gl.uniformMatrix4fv(at.place, false, IDENTITY);
    gl.uniform1f(at.flat_, 1);
    for (const { points, colour, over } of lines) {
      if (over) gl.disable(gl.DEPTH_TEST);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points.flat()), gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.uniform4fv(at.colour, colour);
      gl.drawArrays(gl.LINES, 0, points.length);
      gl.enable(gl.DEPTH_TEST);
    }
  }

  #upload(node) {
    const gl = this.#gl;
    const { positions, normals, indices, lines } = node.mesh;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const vectors = (place, numbers) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
      return buffer;
    };
    const shape = { node, array, lines, count: indices ? indices.length : positions.length / 3, positions: vectors(0, positions) };
    if (normals) shape.normals = vectors(1, normals);
    if (indices) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    }
    return shape;
  }
}
