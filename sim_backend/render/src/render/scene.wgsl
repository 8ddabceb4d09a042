// Geometry of one frame. All positions and directions are in the camera frame (x right, y down, z along the view)
// unless their names say otherwise.

// Shadows, surroundings and relief, or none of them.
override FULL: bool = true;
// Shadows with penumbras, light that seeps under the surface of tissue and breaks in the film on it, worn paint.
override FINE: bool = false;
// Side of the image that a pattern is painted in, m.
override PATTERN_SIZE_M: f32 = 0.18;
// The same of what is behind everything.
override BACKDROP_SIZE_M: f32 = 0.36;
// Depth range of the shadow map, m.
override SHADOW_NEAR_M: f32 = 0.01;
override SHADOW_FAR_M: f32 = 0.7;

struct Frame {
    clip_from_camera: mat4x4f,
    light_clip_from_camera: mat4x4f,
    light_position: vec3f,
    // Brightness times the square of the distance, m^2.
    light_power: f32,
    light_axis: vec3f,
    cone_cos_outer: f32,
    cone_cos_inner: f32,
    ambient: f32,
    // Half width of the shadow map over distance, and of one of its texels.
    shadow_window_tan: f32,
    shadow_texel_tan: f32,
    // The scene's z axis.
    up: vec3f,
    // Height of the backdrop's floor in the scene, m.
    floor: f32,
    // What the things in the scene throw back from below.
    bounce: vec3f,
    backdrop_layer: f32,
    backdrop_roughness: f32,
    backdrop_wetness: f32,
    backdrop_walls: f32,
    // Share by which the light has more red and less blue.
    warmth: f32,
    // Principal point, pixels, and one over the focal lengths.
    lens: vec4f,
    scene_from_camera: mat4x4f,
    // Factor of the light that the sensor collects.
    exposure: f32,
}

struct Object {
    camera_from_object: mat4x4f,
    base_colour: vec3f,
    metallic: f32,
    roughness: f32,
    wetness: f32,
    detail: f32,
    instance: f32,
    // Where its pattern lies among the painted ones.
    layer: f32,
    // Factors of its colour.
    tint_red: f32,
    tint_green: f32,
    tint_blue: f32,
    // Counts what is drawn, from 1.
    part: f32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
// Of the part that is drawn. As a storage buffer it would be read lane by lane in software.
@group(0) @binding(1) var<uniform> object: Object;
@group(1) @binding(0) var shadow_map: texture_depth_2d;
@group(1) @binding(1) var shadow_sampler: sampler_comparison;
@group(1) @binding(2) var albedo_map: texture_2d_array<f32>;
@group(1) @binding(3) var relief_map: texture_2d_array<f32>;
@group(1) @binding(4) var pattern_sampler: sampler;

struct Varying {
    @builtin(position) @invariant clip: vec4f,
    // With one sample a pixel the centroid is its centre.
    @interpolate(perspective, centroid) @location(0) position: vec3f,
    @interpolate(perspective, centroid) @location(1) object_position: vec3f,
    @interpolate(perspective, centroid) @location(2) object_normal: vec3f,
    // Where on its surface the point is, m; it stays the same when the surface is deformed.
    @interpolate(perspective, centroid) @location(3) unrolled: vec2f,
    // How open it is to the light from all around, and how much light comes through it.
    @interpolate(perspective, centroid) @location(4) baked: vec2f,
}

@vertex
fn scene_vertex(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) unrolled: vec2f,
) -> Varying {
    let in_camera = object.camera_from_object * vec4f(position, 1.0);
    return Varying(
        frame.clip_from_camera * in_camera, in_camera.xyz, position, normal, unrolled, vec2f(1.0, 0.0)
    );
}

// The same with what was baked into the vertex.
@vertex
fn baked_vertex(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) unrolled: vec2f,
    @location(3) baked: vec2f,
) -> Varying {
    let in_camera = object.camera_from_object * vec4f(position, 1.0);
    return Varying(frame.clip_from_camera * in_camera, in_camera.xyz, position, normal, unrolled, baked);
}

struct Seen {
    @builtin(position) @invariant clip: vec4f,
    @location(0) range: f32,
    @location(1) @interpolate(flat) instance: u32,
}

struct Label {
    @location(0) instance: u32,
    @location(1) range: f32,
}

// What is where: the only source of ids and depth, whatever the colours are.
@vertex
fn label_vertex(@location(0) position: vec3f) -> Seen {
    let in_camera = object.camera_from_object * vec4f(position, 1.0);
    return Seen(frame.clip_from_camera * in_camera, in_camera.z, u32(object.instance));
}

@fragment
fn label_fragment(in: Seen) -> Label {
    return Label(in.instance, in.range);
}

// The same from the light, whose records say "camera" and mean the light.
@vertex
fn shadow_vertex(@location(0) position: vec3f) -> @builtin(position) vec4f {
    return frame.clip_from_camera * (object.camera_from_object * vec4f(position, 1.0));
}
