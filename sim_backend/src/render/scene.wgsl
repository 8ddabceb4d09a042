// Geometry of one frame. All positions and directions are in the camera frame (x right, y down, z along the view)
// unless their names say otherwise.

// Whether the shadow map is read.
override SHADOWS: bool = true;
override SHADOW_MAP_PX: f32 = 768.0;

struct Frame {
    clip_from_camera: mat4x4f,
    light_clip_from_camera: mat4x4f,
    light_position: vec3f,
    // Brightness times the square of the distance, m^2.
    light_power: f32,
    cone_cos_outer: f32,
    cone_cos_inner: f32,
    ambient: f32,
    // Half width of the shadow map over distance.
    shadow_window_tan: f32,
    // The scene's z axis.
    up: vec3f,
    unused: f32,
}

struct Object {
    camera_from_object: mat4x4f,
    base_colour: vec3f,
    metallic: f32,
    roughness: f32,
    wetness: f32,
    detail: f32,
    instance: f32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> objects: array<Object>;
@group(1) @binding(0) var shadow_map: texture_depth_2d;
@group(1) @binding(1) var shadow_sampler: sampler_comparison;

struct Varying {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) object_position: vec3f,
    @location(2) object_normal: vec3f,
    @location(3) @interpolate(flat) object: u32,
}

struct Pixel {
    @location(0) colour: vec4f,
    @location(1) instance: u32,
    @location(2) range: f32,
}

@vertex
fn scene_vertex(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @builtin(instance_index) object: u32,
) -> Varying {
    let in_camera = objects[object].camera_from_object * vec4f(position, 1.0);
    return Varying(frame.clip_from_camera * in_camera, in_camera.xyz, position, normal, object);
}

@vertex
fn shadow_vertex(@location(0) position: vec3f, @builtin(instance_index) object: u32) -> @builtin(position) vec4f {
    return frame.light_clip_from_camera * (objects[object].camera_from_object * vec4f(position, 1.0));
}

@fragment
fn scene_fragment(in: Varying) -> Pixel {
    let footprint_m = length(fwidth(in.object_position));
    let object = objects[in.object];
    let normal = normalize(in.object_normal);
    let surface = surface_of(object, in.object_position, normal, footprint_m);
    let linear = shade(surface, in.position, (object.camera_from_object * vec4f(normal, 0.0)).xyz);
    // Soft shoulder: highlights saturate slowly, as an endoscope's exposure control makes them.
    let exposed = vec3f(1.0) - exp(-linear);
    return Pixel(vec4f(exposed, 1.0), u32(object.instance), in.position.z);
}
