
// What surfaces look like: wet tissue with fibres and vessels, brushed metal, and the light on them.

struct Surface {
    normal: vec3f,
    // Normal of the film of fluid, whose menisci are steeper than the flesh.
    film_normal: vec3f,
    base_colour: vec3f,
    metallic: f32,
    roughness: f32,
    wetness: f32,
}

// 0 to 1 from a lattice point; integer arithmetic, so the same everywhere.
fn lattice(p: vec3i) -> f32 {
    let u = bitcast<vec3u>(p);
    var h = (u.x * 0x9e3779b1u) ^ (u.y * 0x85ebca77u) ^ (u.z * 0xc2b2ae3du);
    h = (h ^ (h >> 15u)) * 0x2c1b3c6du;
    h = h ^ (h >> 12u);
    return f32(h >> 8u) * 5.9604645e-8;
}

// Smooth noise, mean 0.5: gradient in xyz, value in w.
fn noise(p: vec3f) -> vec4f {
    let cell = floor(p);
    let i = vec3i(cell);
    let f = p - cell;
    let s = f * f * (3.0 - 2.0 * f);
    let ds = 6.0 * f * (1.0 - f);
    let low = vec4f(
        lattice(i),
        lattice(i + vec3i(1, 0, 0)),
        lattice(i + vec3i(0, 1, 0)),
        lattice(i + vec3i(1, 1, 0)),
    );
    let high = vec4f(
        lattice(i + vec3i(0, 0, 1)),
        lattice(i + vec3i(1, 0, 1)),
        lattice(i + vec3i(0, 1, 1)),
        lattice(i + vec3i(1, 1, 1)),
    );
    let flat = mix(low, high, s.z);
    let row = mix(flat.xy, flat.zw, s.y);
    let rise = high - low;
    let rise_row = mix(rise.xy, rise.zw, s.y);
    let gradient = vec3f(
        row.y - row.x,
        mix(flat.z - flat.x, flat.w - flat.y, s.x),
        mix(rise_row.x, rise_row.y, s.x),
    );
    return vec4f(gradient * ds, mix(row.x, row.y, s.x));
}

// Muscle: lobes, fibre bundles along the object's x axis, pale fascia between them, thin dark vessels.
fn tissue(object: Object, p: vec3f, n: vec3f, footprint_m: f32) -> Surface {
    let lobes = noise(p * 75.0);
    let lumps = noise(p * 210.0 + 17.0);
    let broad = 0.65 * lobes.w + 0.35 * lumps.w;
    // Bundles wander with the lobes.
    let bent = p + vec3f(0.0, 0.0040, 0.0020) * (broad - 0.5);
    let bundle_scale = vec3f(95.0, 780.0, 420.0);
    let bundles = noise(bent * bundle_scale + 5.0);
    let fibre_scale = vec3f(260.0, 2300.0, 1500.0);
    // What is finer than the pixels fades to its mean instead of flickering.
    let blur = smoothstep(0.6, 1.4, footprint_m * 2300.0);
    let fibres = mix(noise(bent * fibre_scale + 31.0), vec4f(0.0, 0.0, 0.0, 0.5), blur);
    let strands = 0.6 * bundles.w + 0.4 * fibres.w;

    let amount = object.detail;
    let fascia = smoothstep(0.60, 0.85, strands) * smoothstep(0.35, 0.65, lumps.w);
    let steepness = length(lobes.xyz) * 75.0;
    let off_line = abs(lobes.w + 0.22 * (lumps.w - 0.5) - 0.53) / max(steepness, 20.0);
    // Thin, and gone where the noise is flat: there the line would spread into a blot.
    let vessel = (1.0 - smoothstep(0.00012, 0.00042, off_line)) * smoothstep(0.34, 0.52, lumps.w)
        * smoothstep(25.0, 60.0, steepness);
    var colour = object.base_colour * (1.0 + amount * (1.5 * (strands - 0.5) + 1.0 * (broad - 0.5)));
    colour = mix(colour, object.base_colour * vec3f(1.2, 2.8, 2.6), 0.5 * amount * fascia);
    colour = mix(colour, object.base_colour * vec3f(0.42, 0.30, 0.55), 0.75 * amount * vessel);

    let swell = lobes.xyz * 75.0 * 0.00110 + lumps.xyz * 210.0 * 0.00050;
    let relief = bundles.xyz * bundle_scale * 0.00034 + fibres.xyz * fibre_scale * 0.00007;
    let bumped = n - amount * tangential(swell + relief - 0.0003 * vessel * lobes.xyz, n);
    let film = n - amount * tangential(1.6 * swell + 2.4 * relief, n);
    return Surface(
        normalize(bumped),
        normalize(film),
        clamp(colour, vec3f(0.0), vec3f(1.0)),
        0.0,
        object.roughness,
        object.wetness * (0.75 + 0.5 * lumps.w),
    );
}

// Machined metal: fine grooves around the object's z axis and slightly uneven polish.
fn metal(object: Object, p: vec3f, n: vec3f) -> Surface {
    let smudge = noise(p * 420.0 + 3.0);
    let groove_scale = vec3f(300.0, 300.0, 6000.0);
    let groove = noise(p * groove_scale);
    let amount = object.detail;
    let bumped = normalize(n - amount * tangential(groove.xyz * groove_scale * 0.000012, n));
    let roughness = object.roughness * (1.0 + amount * 0.6 * (smudge.w - 0.5));
    let colour = object.base_colour * (1.0 - amount * 0.25 * smudge.w);
    return Surface(bumped, bumped, colour, object.metallic, roughness, object.wetness);
}

fn tangential(v: vec3f, n: vec3f) -> vec3f {
    return v - dot(v, n) * n;
}

fn surface_of(object: Object, p: vec3f, n: vec3f, footprint_m: f32) -> Surface {
    var surface: Surface;
    if object.metallic < 0.5 {
        surface = tissue(object, p, n, footprint_m);
    } else {
        surface = metal(object, p, n);
    }
    surface.normal = (object.camera_from_object * vec4f(surface.normal, 0.0)).xyz;
    surface.film_normal = (object.camera_from_object * vec4f(surface.film_normal, 0.0)).xyz;
    return surface;
}

// Share of the light that arrives: the mean of two taps, each of which blends four texels.
fn lit(position: vec3f, normal: vec3f) -> f32 {
    if !SHADOWS {
        return 1.0;
    }
    let distance = position.z - frame.light_position.z;
    let texel_m = 2.0 * max(distance, 0.0) * frame.shadow_window_tan / SHADOW_MAP_PX;
    let clip = frame.light_clip_from_camera * vec4f(position + 2.0 * texel_m * normal, 1.0);
    let ndc = clip.xyz / clip.w;
    let at = vec2f(0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y);
    let step = vec2f(0.9, 0.35) / SHADOW_MAP_PX;
    let sum = textureSampleCompareLevel(shadow_map, shadow_sampler, at + step, ndc.z)
        + textureSampleCompareLevel(shadow_map, shadow_sampler, at - step, ndc.z);
    let outside = max(abs(ndc.x), abs(ndc.y)) > 0.995;
    return select(0.5 * sum, 1.0, outside);
}

// GGX with Smith's joint masking in the approximation of Hammon (2017) and Schlick's Fresnel.
fn specular(n: vec3f, v: vec3f, l: vec3f, roughness: f32, f0: vec3f) -> vec3f {
    let h = normalize(v + l);
    let n_l = max(dot(n, l), 0.0);
    let n_v = max(dot(n, v), 1e-3);
    let n_h = max(dot(n, h), 0.0);
    let a = roughness * roughness;
    let a2 = a * a;
    let d = n_h * n_h * (a2 - 1.0) + 1.0;
    let distribution = a2 / (3.14159265 * d * d);
    let masking = 0.5 / mix(2.0 * n_l * n_v, n_l + n_v, a);
    return n_l * distribution * masking * fresnel(max(dot(h, l), 0.0), f0);
}

fn fresnel(cosine: f32, f0: vec3f) -> vec3f {
    let x = 1.0 - cosine;
    let x2 = x * x;
    return f0 + (vec3f(1.0) - f0) * (x2 * x2 * x);
}

// What a mirror sees inside the body: tissue below, a dim cavity above, the glow around the endoscope behind.
fn surroundings(direction: vec3f) -> vec3f {
    let height = smoothstep(-0.5, 0.7, dot(direction, frame.up));
    let glow = max(-direction.z, 0.0);
    let walls = mix(vec3f(0.72, 0.34, 0.29), vec3f(0.30, 0.20, 0.19), height);
    return walls + vec3f(1.25, 1.15, 1.10) * glow * glow * glow;
}

fn shade(s: Surface, position: vec3f, mesh_normal: vec3f) -> vec3f {
    let to_light = frame.light_position - position;
    let distance2 = dot(to_light, to_light);
    let l = to_light * inverseSqrt(distance2);
    let v = -normalize(position);
    let spot = smoothstep(frame.cone_cos_outer, frame.cone_cos_inner, -l.z);
    let arriving = frame.light_power / distance2 * spot * lit(position, mesh_normal);
    let roughness = clamp(s.roughness, 0.08, 1.0);
    let f0 = mix(vec3f(0.04), s.base_colour, s.metallic);
    let albedo = s.base_colour * (1.0 - s.metallic);

    // Red light travels further under the surface and comes out beyond the terminator.
    let n_l = dot(s.normal, l);
    let wrap = (1.0 - s.metallic) * vec3f(0.30, 0.08, 0.06);
    let diffuse = albedo * max((vec3f(n_l) + wrap) / (vec3f(1.0) + wrap), vec3f(0.0)) / (vec3f(1.0) + wrap);
    var direct = diffuse + specular(s.normal, v, l, roughness, f0);
    direct += s.wetness * specular(s.film_normal, v, l, 0.30, vec3f(0.09));

    let facing = 0.5 + 0.5 * dot(s.normal, frame.up);
    var around = albedo * mix(vec3f(0.55, 0.36, 0.34), vec3f(1.0, 0.92, 0.9), facing);
    let n_v = max(dot(s.normal, v), 0.0);
    let mirror = surroundings(reflect(-v, s.normal));
    around += mirror * fresnel(n_v, f0) * (1.0 - 0.45 * roughness) * mix(0.35, 2.8, s.metallic);
    around += s.wetness * 0.5 * surroundings(reflect(-v, s.film_normal)) * fresnel(max(dot(s.film_normal, v), 0.0), vec3f(0.02));
    return arriving * direct + frame.ambient * around;
}
