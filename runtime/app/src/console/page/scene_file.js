// Reads the scene's file (binary glTF, as the program writes it: f32 vectors, u32 indices) and the messages that say where everything is.

const TEXT = 0x4e4f534a;

/** The stream of the scene among those that a page asks for. */
export const SCENE = 255;

/** Nodes as { name, kind, mesh, colour, metallic, pose, camera }; a mesh as { positions, normals, indices, lines }. */
export function parseScene(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, true) !== 0x46546c67 || view.getUint32(16, true) !== TEXT) throw new Error("no scene file");
  const length = view.getUint32(12, true);
  const file = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const start = 20 + length + 8;
  const numbers = (index, of) => {
    const accessor = file.accessors[index];
    const at = start + file.bufferViews[accessor.bufferView].byteOffset;
    return new of(buffer, at, accessor.count * (accessor.type === "VEC3" ? 3 : 1));
  };
  // The root stands for glTF's y axis being upwards; below it z is.
  const root = file.nodes[file.scenes[0].nodes[0]];
  return root.children.map((index) => file.nodes[index]).map((node) => {
    const kind = node.extras?.kind ?? "thing";
    const pose = [...(node.translation ?? [0, 0, 0]), ...(node.rotation ?? [0, 0, 0, 1])];
    const result = { name: node.name, kind, pose, mesh: null, camera: null };
    if (kind === "camera") result.camera = file.cameras[node.extras.camera].perspective;
    if (node.mesh === undefined) return result;
    const primitive = file.meshes[node.mesh].primitives[0];
    const material = file.materials[primitive.material].pbrMetallicRoughness;
    result.colour = material.baseColorFactor;
    result.metallic = material.metallicFactor ?? 0;
    result.mesh = {
      positions: numbers(primitive.attributes.POSITION, Float32Array),
      normals: primitive.attributes.NORMAL === undefined ? null : numbers(primitive.attributes.NORMAL, Float32Array),
      indices: primitive.indices === undefined ? null : numbers(primitive.indices, Uint32Array),
      lines: primitive.mode === 1,
    };
    return result;
  });
}

/** { visuals, cameras } as arrays of [x, y, z, qx, qy, qz, qw], and bent shapes as { index, positions, normals }. */
export function parsePlaces(buffer) {
  const view = new DataView(buffer);
  const [visuals, cameras, shapes] = [16, 20, 24].map((at) => view.getUint32(at, true));
  let at = 28;
  const take = (count) => {
    const numbers = new Float32Array(buffer.slice(at, at + 4 * count));
    at += 4 * count;
    return numbers;
  };
  const poses = (count) => Array.from({ length: count }, () => Array.from(take(7)));
  const places = { visuals: poses(visuals), cameras: poses(cameras), bent: [] };
  for (let i = 0; i < shapes; i++) {
    const [index, vertices] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    at += 8;
    places.bent.push({ index, positions: take(3 * vertices), normals: take(3 * vertices) });
  }
  return places;
}
