// The kinds of surfaces: patterned ones (flesh, skin, cloth), smooth ones (paint, plastic, polished steel), brushed steel,
// and the backdrop.

fn rotated(object: Object, v: vec3f) -> vec3f {
    return (object.camera_from_object * vec4f(v, 0.0)).xyz;
}

// What `object` throws back of each colour where it would be `colour` without a tint.
fn tinted(object: Object, colour: vec3f) -> vec3f {
    return colour * vec3f(object.tint_red, object.tint_green, object.tint_blue);
}

// Slopes of flesh (xy) and film (zw) along the pattern's axes.
fn slopes(at: vec2f, layer: i32, blur: f32) -> vec4f {
    return 2.0 * textureSampleBias(relief_map, pattern_sampler, at, layer, blur) - 1.0;
}

// `n` tilted by slopes along the pattern's axes, which are x and y turned with z towards `n`.
fn tilted(n: vec3f, slope: vec2f) -> vec3f {
    let share = 1.0 / (1.0 + max(n.z, -0.95));
    let u = vec3f(1.0 - n.x * n.x * share, -n.x * n.y * share, -n.x);
    let v = vec3f(-n.x * n.y * share, 1.0 - n.y * n.y * share, -n.y);
    return normalize(n - slope.x * u - slope.y * v);
}

// Factors of the slopes of flesh (xy) and film (zw) in fine pictures.
const FINE_RELIEF: vec4f = vec4f(1.3, 1.3, 1.7, 1.7);

fn patterned(in: Varying) -> Surface {
    let at = in.unrolled / PATTERN_SIZE_M + 0.5;
    let layer = i32(object.layer);
    let painted = textureSample(albedo_map, pattern_sampler, at, layer);
    let n = normalize(in.object_normal);
    var s: Surface;
    s.position = in.position;
    s.mesh_normal = rotated(object, n);
    s.normal = s.mesh_normal;
    s.film_normal = s.mesh_normal;
    if FULL {
        var slope = object.detail * slopes(at, layer, 0.0);
        if FINE {
            slope *= FINE_RELIEF;
        }
        s.normal = rotated(object, tilted(n, slope.xy));
        s.film_normal = rotated(object, tilted(n, slope.zw));
    }
    s.base_colour = tinted(object, painted.rgb);
    s.roughness = object.roughness;
    s.wetness = object.wetness;
    s.open = painted.a;
    s.flesh = min(2.0 * object.wetness, 1.0);
    if FINE {
        s.open *= in.baked.x;
        s.through = in.baked.y;
    }
    return s;
}

@fragment
fn patterned_fragment(in: Varying) -> @location(0) vec4f {
    return exposed(shade(patterned(in)));
}

// Wear of a coat or paint at `p`: the relative change of roughness (x), and how much lighter it is (y). Smudges everywhere; scratches
// in places, along z on steep faces, in two directions on level ones.
fn wear(p: vec3f, n: vec3f) -> vec2f {
    var at = p.xy;
    var scratches = 0.0;
    if abs(n.z) > 0.7 {
        // Domain warping: scratches are not straight.
        let bent = at + 0.005 * vec2f(noise(85.0 * at, 11), noise(70.0 * at, 12));
        let aslant = vec2f(0.6 * bent.x + 0.8 * bent.y, 0.6 * bent.y - 0.8 * bent.x);
        scratches = max(noise(vec2f(2400.0, 85.0) * bent, 13), noise(vec2f(2700.0, 140.0) * aslant, 14));
    } else {
        at = vec2f(length(p.xy) * atan2(p.y, p.x), p.z);
        scratches = noise(vec2f(2400.0, 85.0) * at, 13);
    }
    let handled = noise(55.0 * at, 9);
    let smudge = 0.5 * handled + 0.5 * noise(410.0 * at, 10) - 0.5;
    let scratched = smoothstep(0.80, 0.97, scratches) * smoothstep(0.45, 0.75, handled);
    return vec2f(0.7 * smudge + 0.5 * scratched, 0.4 * smudge + scratched);
}

fn smooth_surface(in: Varying) -> Surface {
    var s: Surface;
    s.position = in.position;
    s.mesh_normal = rotated(object, normalize(in.object_normal));
    s.normal = s.mesh_normal;
    s.film_normal = s.mesh_normal;
    s.base_colour = tinted(object, object.base_colour);
    s.metallic = object.metallic;
    s.roughness = object.roughness;
    s.wetness = object.wetness;
    s.open = 1.0;
    if FINE {
        s.open = in.baked.x;
        // How worn it is: neither metal nor what is wet.
        let worn = object.detail * (1.0 - s.metallic) * (1.0 - min(10.0 * s.wetness, 1.0));
        if worn > 0.0 {
            let change = worn * wear(in.object_position, normalize(in.object_normal));
            s.roughness *= 1.0 + change.x;
            s.base_colour = s.base_colour * (1.0 + 0.10 * change.y) + 0.007 * max(change.y, 0.0);
        }
    }
    return s;
}

@fragment
fn smooth_fragment(in: Varying) -> @location(0) vec4f {
    return exposed(shade(smooth_surface(in)));
}

// Machined metal: fine grooves around the object's z axis and slightly uneven polish.
fn brushed(in: Varying) -> Surface {
    let n = normalize(in.object_normal);
    var s: Surface;
    s.position = in.position;
    s.mesh_normal = rotated(object, n);
    s.normal = s.mesh_normal;
    s.base_colour = tinted(object, object.base_colour);
    s.roughness = object.roughness;
    if FULL {
        let p = in.object_position;
        let around = p.x + 1.7 * p.y;
        let smudge = noise(vec2f(300.0 * around, 300.0 * p.z), 7) - 0.5;
        let groove = noise(vec2f(350.0 * around, 5200.0 * p.z), 8) - 0.5;
        let axis = vec3f(0.0, 0.0, 1.0);
        let tilt = 0.10 * object.detail * groove * (axis - n * n.z);
        s.normal = rotated(object, normalize(n + tilt));
        s.roughness = object.roughness * (1.0 + 0.5 * object.detail * smudge);
        s.base_colour = s.base_colour * (1.0 - 0.25 * object.detail * (0.5 + smudge));
    }
    s.film_normal = s.normal;
    s.metallic = object.metallic;
    s.wetness = object.wetness;
    s.open = select(1.0, in.baked.x, FINE);
    return s;
}

@fragment
fn brushed_fragment(in: Varying) -> @location(0) vec4f {
    return exposed(shade(brushed(in)));
}

struct Behind {
    @builtin(position) clip: vec4f,
}

// A triangle over the whole image at the far end of the depth range.
@vertex
fn backdrop_vertex(@builtin(vertex_index) index: u32) -> Behind {
    let x = f32(i32(index & 1u) * 4 - 1);
    let y = f32(i32(index >> 1u) * 4 - 1);
    return Behind(vec4f(x, y, 1.0, 1.0));
}

// Half axes of the cavity's wall and the height of its middle, m.
const CAVITY: vec3f = vec3f(0.26, 0.24, 0.20);
const CAVITY_MIDDLE: f32 = 0.03;

// Levels by which it is out of focus, and in fine pictures.
const BLUR: f32 = 0.75;
const FINE_BLUR: f32 = 1.9;

// What is behind everything: a floor, and a wall around it that is the far side of an ellipsoid.
fn behind(in: Behind) -> Surface {
    let ray = vec3f((in.clip.xy - frame.lens.xy) * frame.lens.zw, 1.0);
    let d = (frame.scene_from_camera * vec4f(ray, 0.0)).xyz;
    let eye = frame.scene_from_camera[3].xyz;
    let start = (eye - vec3f(0.0, 0.0, CAVITY_MIDDLE)) / CAVITY;
    let along = d / CAVITY;
    let a = dot(along, along);
    let b = dot(start, along);
    let wall = (-b + sqrt(max(b * b - a * (dot(start, start) - 1.0), 0.0))) / a;
    let to_floor = (frame.floor - eye.z) / select(d.z, -1e-6, abs(d.z) < 1e-6);
    let on_floor = to_floor > 0.0 && to_floor < max(wall, 1e-3);
    let distance = select(max(wall, 1e-3), to_floor, on_floor);
    let hit = eye + distance * d;
    let outward = (hit - vec3f(0.0, 0.0, CAVITY_MIDDLE)) / (CAVITY * CAVITY);
    let n = select(-normalize(outward), vec3f(0.0, 0.0, 1.0), on_floor);
    let at = (hit.xy - n.xy * (hit.z - frame.floor)) / BACKDROP_SIZE_M + 0.5;
    let layer = i32(frame.backdrop_layer);
    let blur = select(BLUR, FINE_BLUR, FINE);
    let painted = textureSampleBias(albedo_map, pattern_sampler, at, layer, blur);
    var bumped = n;
    if FULL {
        bumped = tilted(n, slopes(at, layer, blur).xy);
    }
    let to_camera = transpose(mat3x3f(
        frame.scene_from_camera[0].xyz,
        frame.scene_from_camera[1].xyz,
        frame.scene_from_camera[2].xyz,
    ));
    var s: Surface;
    s.position = distance * ray;
    s.mesh_normal = to_camera * n;
    s.normal = to_camera * bumped;
    s.film_normal = s.normal;
    let share = select(frame.backdrop_walls, 1.0, on_floor);
    s.base_colour = painted.rgb * share;
    s.roughness = frame.backdrop_roughness;
    s.wetness = frame.backdrop_wetness * share * share;
    s.open = painted.a;
    s.flesh = min(2.0 * frame.backdrop_wetness, 1.0);
    return s;
}

@fragment
fn backdrop_fragment(in: Behind) -> @location(0) vec4f {
    return exposed(shade(behind(in)));
}
