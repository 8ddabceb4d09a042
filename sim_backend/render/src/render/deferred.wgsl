// Deferred shading: what is seen at each pixel's centre is drawn into a G-buffer of two images and shaded by a compute pass. Then the
// scene is drawn with several samples a pixel, each of which takes the colour of that pixel around it that is most like its surface.

@group(2) @binding(0) var look_seen: texture_2d<u32>;
@group(2) @binding(1) var shape_seen: texture_2d<u32>;
@group(2) @binding(2) var shaded_to: texture_storage_2d<rgba8unorm, write>;
// The same to read.
@group(2) @binding(3) var shaded: texture_2d<f32>;

struct GBuffer {
    // Normals of flesh and film; red and green; roughness, wetness, metallic and what comes through.
    @location(0) look: vec4u,
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

fn packed(s: Surface, part: u32) -> GBuffer {
    let look = vec4u(
        octahedral(s.normal),
        octahedral(s.film_normal),
        pack2x16float(s.base_colour.rg),
        pack4x8unorm(vec4f(s.roughness, s.wetness, s.metallic, s.through)),
    );
    let flesh = u32(round(255.0 * s.flesh));
    let blue = pack2x16float(vec2f(s.base_colour.b, s.open));
    return GBuffer(look, vec4u(part | (flesh << 24u), bitcast<u32>(s.position.z), octahedral(s.mesh_normal), blue));
}

@fragment
fn patterned_gbuffer(in: Varying) -> GBuffer {
    return packed(patterned(in), u32(object.part));
}

@fragment
fn smooth_gbuffer(in: Varying) -> GBuffer {
    return packed(smooth_surface(in), u32(object.part));
}

@fragment
fn brushed_gbuffer(in: Varying) -> GBuffer {
    return packed(brushed(in), u32(object.part));
}

@fragment
fn backdrop_gbuffer(in: Behind) -> GBuffer {
    return packed(behind(in), BACKDROP);
}

// The number of what is behind everything.
const BACKDROP: u32 = 0u;

fn part_of(shape: vec4u) -> u32 {
    return shape.x & 0xffffffu;
}

@compute @workgroup_size(8, 8)
fn shade_gbuffer(@builtin(global_invocation_id) pixel: vec3u) {
    let at = vec2i(pixel.xy);
    if any(at >= vec2i(textureDimensions(shape_seen))) {
        return;
    }
    let shape = textureLoad(shape_seen, at, 0);
    let look = textureLoad(look_seen, at, 0);
    let red_green = unpack2x16float(look.z);
    let blue_open = unpack2x16float(shape.w);
    let rest = unpack4x8unorm(look.w);
    var s: Surface;
    s.position = bitcast<f32>(shape.y) * vec3f((vec2f(at) + 0.5 - frame.lens.xy) * frame.lens.zw, 1.0);
    s.normal = direction(look.x);
    s.film_normal = direction(look.y);
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
    @builtin(position) clip: vec4f,
    // At the centroid, or of pixels that a silhouette crosses what is beyond it would be looked for.
    @interpolate(perspective, centroid) @location(0) normal: vec3f,
    @interpolate(perspective, centroid) @location(1) range: f32,
    @interpolate(flat) @location(2) part: u32,
}

@vertex
fn sampled_vertex(@location(0) position: vec3f, @location(1) normal: vec3f) -> Sampled {
    let in_camera = object.camera_from_object * vec4f(position, 1.0);
    return Sampled(frame.clip_from_camera * in_camera, rotated(object, normal), in_camera.z, u32(object.part));
}

// How unlike what a pixel shows is to a place of `part`: another part counts most, then a step in depth, then a crease. Of what is
// behind everything neither is seen.
fn unlike(shape: vec4u, part: u32, range: f32, normal: vec3f) -> f32 {
    let strange = select(0.0, 1e3, part_of(shape) != part);
    if part == BACKDROP {
        return strange;
    }
    let step = min(abs(bitcast<f32>(shape.y) - range) / range, 1.0);
    let turn = 1.0 - dot(direction(shape.z), normal);
    return strange + 100.0 * step + 10.0 * turn;
}

// Below that the pixel's centre shows the same surface.
const SAME: f32 = 1.0;
// What a pixel's distance counts, so that of pixels that are about as like the nearest is taken.
const AWAY: f32 = 0.1;

// The colour of the pixel at `at`, or of the one around it that is most like a place.
fn shaded_like(at: vec2i, part: u32, range: f32, normal: vec3f) -> vec4f {
    let last = vec2i(textureDimensions(shape_seen)) - 1;
    var best = at;
    var least = unlike(textureLoad(shape_seen, at, 0), part, range, normal);
    if least > SAME {
        for (var index = 0; index < 9; index++) {
            let step = vec2i(index % 3, index / 3) - 1;
            let around = clamp(at + step, vec2i(0), last);
            let far = AWAY * f32(abs(step.x) + abs(step.y));
            let found = unlike(textureLoad(shape_seen, around, 0), part, range, normal) + far;
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
    return shaded_like(vec2i(in.clip.xy), in.part, in.range, normalize(in.normal));
}

@fragment
fn backdrop_sampled(in: Behind) -> @location(0) vec4f {
    return shaded_like(vec2i(in.clip.xy), BACKDROP, 1.0, vec3f(0.0, 0.0, 1.0));
}
