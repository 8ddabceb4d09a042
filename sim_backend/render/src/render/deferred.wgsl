// Deferred shading: what is seen in the middle of each pixel is kept in two images (the G-buffer) and shaded by a compute pass,
// which a GPU runs on more processors than fragments. Pixels with an edge are left to the fragments, whose samples smooth it.

@group(2) @binding(0) var looks_kept: texture_2d<u32>;
@group(2) @binding(1) var shape_kept: texture_2d<u32>;
@group(2) @binding(2) var shaded_to: texture_storage_2d<rgba8unorm, write>;
// The same to read.
@group(2) @binding(3) var shaded: texture_2d<f32>;

struct Kept {
    // Normals of flesh and film; red and green; roughness, wetness, metallic and what comes through.
    @location(0) looks: vec4u,
    // Part and flesh; distance along the view, m; normal of the mesh; blue and openness.
    @location(1) shape: vec4u,
}

// A direction in 32 bits: the octahedron's lower half is folded out around the upper one (Meyer et al. 2010).
fn octahedral(n: vec3f) -> u32 {
    let flat = n / (abs(n.x) + abs(n.y) + abs(n.z));
    return pack2x16snorm(select(folded(flat.xy), flat.xy, flat.z >= 0.0));
}

fn direction(bits: u32) -> vec3f {
    let at = unpack2x16snorm(bits);
    let z = 1.0 - abs(at.x) - abs(at.y);
    return normalize(vec3f(select(folded(at), at, z >= 0.0), z));
}

fn folded(at: vec2f) -> vec2f {
    return (1.0 - abs(at.yx)) * select(vec2f(-1.0), vec2f(1.0), at >= vec2f(0.0));
}

fn kept(s: Surface, part: u32) -> Kept {
    let looks = vec4u(
        octahedral(s.normal),
        octahedral(s.film_normal),
        pack2x16float(s.base_colour.rg),
        pack4x8unorm(vec4f(s.roughness, s.wetness, s.metallic, s.through)),
    );
    let flesh = u32(round(255.0 * s.flesh));
    let blue = pack2x16float(vec2f(s.base_colour.b, s.open));
    return Kept(looks, vec4u(part | (flesh << 24u), bitcast<u32>(s.position.z), octahedral(s.mesh_normal), blue));
}

@fragment
fn patterned_kept(in: Varying) -> Kept {
    return kept(patterned(in), u32(object.part));
}

@fragment
fn smooth_kept(in: Varying) -> Kept {
    return kept(smooth_surface(in), u32(object.part));
}

@fragment
fn brushed_kept(in: Varying) -> Kept {
    return kept(brushed(in), u32(object.part));
}

@fragment
fn backdrop_kept(in: Behind) -> Kept {
    return kept(behind(in), 0u);
}

fn part_of(shape: vec4u) -> u32 {
    return shape.x & 0xffffffu;
}

// Cosine of the angle between the normals of neighbours, and share by which one over the distance may leave the line
// through both neighbours, beyond which an edge lies between them. On a plane it is on that line.
const CREASE: f32 = 0.9;
const STEP: f32 = 0.004;

// Whether an edge may cross the pixel: where one crosses and leaves its middle and those of its four neighbours on one side, it is
// too near to a corner for any sample.
fn has_edge(at: vec2i, own: vec4u) -> bool {
    let last = vec2i(textureDimensions(shape_kept)) - 1;
    let normal = direction(own.z);
    let near = 1.0 / bitcast<f32>(own.y);
    var found = false;
    for (var axis = 0; axis < 2; axis++) {
        let step = select(vec2i(0, 1), vec2i(1, 0), axis == 0);
        let before = textureLoad(shape_kept, max(at - step, vec2i(0)), 0);
        let after = textureLoad(shape_kept, min(at + step, last), 0);
        let bend = 1.0 / bitcast<f32>(before.y) + 1.0 / bitcast<f32>(after.y) - 2.0 * near;
        let turn = min(dot(direction(before.z), normal), dot(direction(after.z), normal));
        found |= part_of(before) != part_of(own) || part_of(after) != part_of(own);
        found |= abs(bend) > STEP * near || turn < CREASE;
    }
    return found;
}

@compute @workgroup_size(8, 8)
fn shade_kept(@builtin(global_invocation_id) pixel: vec3u) {
    let at = vec2i(pixel.xy);
    if any(at >= vec2i(textureDimensions(shape_kept))) {
        return;
    }
    let shape = textureLoad(shape_kept, at, 0);
    if has_edge(at, shape) {
        textureStore(shaded_to, at, vec4f(0.0));
        return;
    }
    let looks = textureLoad(looks_kept, at, 0);
    let red_green = unpack2x16float(looks.z);
    let blue_open = unpack2x16float(shape.w);
    let rest = unpack4x8unorm(looks.w);
    var s: Surface;
    s.position = bitcast<f32>(shape.y) * vec3f((vec2f(at) + 0.5 - frame.lens.xy) * frame.lens.zw, 1.0);
    s.normal = direction(looks.x);
    s.film_normal = direction(looks.y);
    s.mesh_normal = direction(shape.z);
    s.base_colour = vec3f(red_green, blue_open.x);
    s.open = blue_open.y;
    s.roughness = rest.x;
    s.wetness = rest.y;
    s.metallic = rest.z;
    s.through = rest.w;
    s.flesh = f32(shape.x >> 24u) / 255.0;
    textureStore(shaded_to, at, exposed(shade(s)));
}

// A triangle over the whole image, nearer than anything.
@vertex
fn shaded_vertex(@builtin(vertex_index) index: u32) -> Behind {
    let x = f32(i32(index & 1u) * 4 - 1);
    let y = f32(i32(index >> 1u) * 4 - 1);
    return Behind(vec4f(x, y, 0.0, 1.0));
}

// Fills what is shaded already and hides what would be drawn there.
@fragment
fn shaded_fragment(in: Behind) -> @location(0) vec4f {
    let colour = textureLoad(shaded, vec2i(in.clip.xy), 0);
    if colour.a == 0.0 {
        discard;
    }
    return colour;
}
