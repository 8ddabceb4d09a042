// Deferred shading: what is seen in the middle of each pixel is kept in two images (the G-buffer) and shaded by a compute pass,
// which a GPU runs on more processors than fragments. Then the scene is drawn with several samples a pixel, each of which takes the
// colour of the nearest pixel that shows its surface.

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

@compute @workgroup_size(8, 8)
fn shade_kept(@builtin(global_invocation_id) pixel: vec3u) {
    let at = vec2i(pixel.xy);
    if any(at >= vec2i(textureDimensions(shape_kept))) {
        return;
    }
    let shape = textureLoad(shape_kept, at, 0);
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

struct Sampled {
    @builtin(position) @invariant clip: vec4f,
    @interpolate(perspective, centroid) @location(0) normal: vec3f,
    @interpolate(perspective, centroid) @location(1) range: f32,
    @interpolate(flat) @location(2) part: u32,
}

@vertex
fn sampled_vertex(@location(0) position: vec3f, @location(1) normal: vec3f) -> Sampled {
    let in_camera = object.camera_from_object * vec4f(position, 1.0);
    return Sampled(frame.clip_from_camera * in_camera, rotated(object, normal), in_camera.z, u32(object.part));
}

// How unlike what a pixel shows is to a place of `part`: another part counts most, then a crease, then a step in depth.
fn unlike(shape: vec4u, part: u32, range: f32, normal: vec3f) -> f32 {
    let apart = abs(bitcast<f32>(shape.y) - range) / range;
    let turned = 1.0 - dot(direction(shape.z), normal);
    return select(0.0, 1e3, part_of(shape) != part) + 10.0 * turned + 100.0 * apart;
}

// What is about as like as the middle of the pixel itself would be.
const ALIKE: f32 = 1.0;

// The colour of the pixel at `at`, or of what around it is more like.
fn nearest_shaded(at: vec2i, part: u32, range: f32, normal: vec3f) -> vec4f {
    let last = vec2i(textureDimensions(shape_kept)) - 1;
    var best = at;
    var least = unlike(textureLoad(shape_kept, at, 0), part, range, normal);
    if least > ALIKE {
        for (var index = 0; index < 9; index++) {
            let around = clamp(at + vec2i(index % 3, index / 3) - 1, vec2i(0), last);
            let found = unlike(textureLoad(shape_kept, around, 0), part, range, normal);
            if found < least {
                least = found;
                best = around;
            }
        }
    }
    return textureLoad(shaded, best, 0);
}

@fragment
fn sampled_fragment(in: Sampled) -> @location(0) vec4f {
    return nearest_shaded(vec2i(in.clip.xy), in.part, in.range, normalize(in.normal));
}

// Of what is behind everything neither depth nor creases count.
@fragment
fn backdrop_sampled(in: Behind) -> @location(0) vec4f {
    let at = vec2i(in.clip.xy);
    let own = textureLoad(shape_kept, at, 0);
    if part_of(own) == 0u {
        return textureLoad(shaded, at, 0);
    }
    return nearest_shaded(at, 0u, 1.0, direction(own.z));
}
