// How surfaces answer the endoscope's light and what is around them.

struct Surface {
    position: vec3f,
    normal: vec3f,
    // Normal of the film of fluid, which is smoother than the flesh.
    film_normal: vec3f,
    // Normal of the mesh, without relief.
    mesh_normal: vec3f,
    base_colour: vec3f,
    metallic: f32,
    roughness: f32,
    wetness: f32,
    // 1 in the open, less in hollows.
    open: f32,
    // How far red light travels under the surface: 1 for flesh, 0 for metal and paint.
    flesh: f32,
    // Share of red light that comes through from the far side.
    through: f32,
}

// The light that reaches a point: towards it, how much, and what share of it is not in shadow.
struct Beam {
    direction: vec3f,
    power: f32,
    lit: f32,
}

fn beam_at(position: vec3f, normal: vec3f) -> Beam {
    let to_light = frame.light_position - position;
    let distance2 = max(dot(to_light, to_light), 1e-6);
    let direction = to_light * inverseSqrt(distance2);
    let spot = smoothstep(frame.cone_cos_outer, frame.cone_cos_inner, -dot(direction, frame.light_axis));
    var lit = 1.0;
    if FULL {
        lit = unshadowed(position, normal, sqrt(distance2));
    }
    return Beam(direction, frame.light_power / distance2 * spot, lit);
}

// A point as the shadow map has it: where in it, how deep, and how far along the light's axis, m.
struct Mapped {
    at: vec2f,
    depth: f32,
    ahead_m: f32,
    outside: bool,
}

fn mapped(position: vec3f) -> Mapped {
    let clip = frame.light_clip_from_camera * vec4f(position, 1.0);
    let ndc = clip.xyz / clip.w;
    // Beyond the map there is no beam either.
    let outside = max(abs(ndc.x), abs(ndc.y)) > 0.995 || clip.w <= 0.0;
    return Mapped(vec2f(0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y), ndc.z, clip.w, outside);
}

// Share of the light that is not in shadow.
fn unshadowed(position: vec3f, normal: vec3f, distance: f32) -> f32 {
    let point = mapped(position + 2.0 * frame.shadow_texel_tan * distance * normal);
    if FINE {
        return soft_unshadowed(position, normal, distance, point);
    }
    return filtered_unshadowed(point);
}

// Percentage-closer filtering: the mean of four taps, each of which blends four texels.
fn filtered_unshadowed(point: Mapped) -> f32 {
    let texel = frame.shadow_texel_tan / frame.shadow_window_tan * 0.5;
    let wide = vec2f(1.5, 0.7) * texel;
    let across = vec2f(-wide.y, wide.x);
    let sum = textureSampleCompareLevel(shadow_map, shadow_sampler, point.at + wide, point.depth)
        + textureSampleCompareLevel(shadow_map, shadow_sampler, point.at - wide, point.depth)
        + textureSampleCompareLevel(shadow_map, shadow_sampler, point.at + across, point.depth)
        + textureSampleCompareLevel(shadow_map, shadow_sampler, point.at - across, point.depth);
    return select(0.25 * sum, 1.0, point.outside);
}

// Width of the light guide's end, and of the widest penumbra, m.
const GUIDE_M = 0.004;
const PENUMBRA_M = 0.003;
// Taps of the blocker search, and those that blend a penumbra.
const SEARCH_TAPS = 12;
const TAPS = 20;

// Point `index` of `count` that fill the unit disc evenly (Vogel 1979).
fn in_disc(index: i32, count: i32) -> vec2f {
    let turn = 2.39996323 * f32(index);
    return sqrt((f32(index) + 0.5) / f32(count)) * vec2f(cos(turn), sin(turn));
}

// The same of a light of the width GUIDE_M: the penumbra is GUIDE_M times the distance from caster to receiver over that from
// light to caster (percentage-closer soft shadows, Fernando 2005).
fn soft_unshadowed(position: vec3f, normal: vec3f, distance: f32, point: Mapped) -> f32 {
    if point.outside {
        return 1.0;
    }
    // Texture coordinates per metre across the axis at that distance.
    let per_m = 0.5 / (frame.shadow_window_tan * point.ahead_m);
    let search = 0.5 * PENUMBRA_M * per_m;
    let side = vec2f(textureDimensions(shadow_map));
    // What lies in the surface itself casts no shadow on it.
    let lifted = mapped(position + 0.5 * PENUMBRA_M * normal);
    var casters = 0.0;
    var casters_m = 0.0;
    for (var index = 0; index < SEARCH_TAPS; index++) {
        let texel = vec2i((lifted.at + search * in_disc(index, SEARCH_TAPS)) * side);
        let depth = textureLoad(shadow_map, texel, 0);
        if depth < lifted.depth {
            casters += 1.0;
            casters_m += SHADOW_NEAR_M * SHADOW_FAR_M / (SHADOW_FAR_M - depth * (SHADOW_FAR_M - SHADOW_NEAR_M));
        }
    }
    if casters == 0.0 {
        // In the open, or right under what it touches, where there is no penumbra.
        return filtered_unshadowed(point);
    }
    let caster_m = casters_m / casters;
    let penumbra_m = GUIDE_M * max(point.ahead_m - caster_m, 0.0) / max(caster_m, SHADOW_NEAR_M);
    // Of one texel and a half at least, or its steps are seen.
    let texel_m = frame.shadow_texel_tan * point.ahead_m;
    let radius_m = clamp(0.5 * penumbra_m, 1.5 * texel_m, 0.5 * PENUMBRA_M);
    let receiver = mapped(position + (2.0 * frame.shadow_texel_tan * distance + 0.5 * radius_m) * normal);
    var sum = 0.0;
    for (var index = 0; index < TAPS; index++) {
        let at = receiver.at + radius_m * per_m * in_disc(index, TAPS);
        sum += textureSampleCompareLevel(shadow_map, shadow_sampler, at, receiver.depth);
    }
    return sum / f32(TAPS);
}

// GGX with Smith's joint masking in the approximation of Hammon (2017), without Fresnel's factor.
fn glint(n_l: f32, n_v: f32, n_h: f32, roughness: f32) -> f32 {
    let a = roughness * roughness;
    let a2 = a * a;
    let d = n_h * n_h * (a2 - 1.0) + 1.0;
    return n_l * a2 / (3.14159265 * d * d) * 0.5 / mix(2.0 * n_l * n_v, n_l + n_v, a);
}

// Schlick's.
fn fresnel(cosine: f32, f0: vec3f) -> vec3f {
    let x = 1.0 - cosine;
    let x2 = x * x;
    return f0 + (vec3f(1.0) - f0) * (x2 * x2 * x);
}

// What share of its surroundings a surface mirrors: of flesh a bounded one, whose film is not level over a pixel at its silhouette.
fn mirrored(cosine: f32, f0: vec3f, flesh: f32) -> vec3f {
    let level = fresnel(cosine, f0);
    return mix(level, min(level, vec3f(0.30)), flesh);
}

// What a mirror sees: the lit scene below, a dim cavity above, the glow of the light guide, and a dark gap between.
fn surroundings(direction: vec3f, beam: Beam, roughness: f32) -> vec3f {
    let height = dot(direction, frame.up);
    let soft = 0.10 + 0.7 * roughness;
    let below = 1.0 - smoothstep(-0.10 - soft, -0.10 + soft, height);
    let above = smoothstep(0.1 - soft, 0.75 + soft, height);
    let power = min(beam.power, 4.0);
    let grey = select(0.65, 0.25, FINE);
    let floor = mix(frame.bounce, vec3f(dot(frame.bounce, vec3f(0.4))), grey) * (0.10 + 0.40 * power);
    let walls = mix(vec3f(0.05, 0.042, 0.040), vec3f(0.28, 0.26, 0.255), above) * (0.4 + 0.6 * power);
    let towards = max(dot(direction, beam.direction), 0.0);
    let t2 = towards * towards;
    let t4 = t2 * t2;
    let halo = mix(t4 * t4 * t4, t4, roughness);
    // The lit wall opposite, which wet ground mirrors towards the lens.
    let opposite = frame.light_axis - 2.0 * dot(frame.light_axis, frame.up) * frame.up;
    let far = max(dot(direction, opposite), 0.0);
    let far4 = far * far * far * far;
    let far16 = far4 * far4 * far4 * far4;
    let far64 = far16 * far16 * far16 * far16;
    let glow = mix(far64 * far64 * 1.2, far4 * 0.3, smoothstep(0.15, 0.6, roughness));
    let white = vec3f(0.95, 0.93, 0.88);
    return mix(walls, floor, below) + white * (power * (halo * 1.1 + glow));
}

fn shade(s: Surface) -> vec3f {
    let beam = beam_at(s.position, s.mesh_normal);
    let v = -normalize(s.position);
    let l = beam.direction;
    let n_l = dot(s.normal, l);
    let albedo = s.base_colour * (1.0 - s.metallic);
    // Red light travels further under the surface and comes out beyond the terminator, and into shadows.
    var wrap = s.flesh * vec3f(0.34, 0.09, 0.06);
    var n_l_of = vec3f(n_l);
    if FULL {
        // Relief that is smaller than the way of the light under the surface does not shade it: red least of all.
        n_l_of = mix(n_l_of, vec3f(dot(s.mesh_normal, l)), s.flesh * vec3f(0.75, 0.40, 0.25));
    }
    if FINE {
        wrap += s.flesh * s.through * vec3f(0.30, 0.05, 0.03);
    }
    let diffuse = albedo * max((n_l_of + wrap) / ((vec3f(1.0) + wrap) * (vec3f(1.0) + wrap)), vec3f(0.0));
    let facing = 0.5 + 0.5 * dot(s.normal, frame.up);
    let sky = mix(frame.bounce + 0.25, vec3f(1.0, 0.93, 0.90), facing) * s.open;
    if !FULL {
        let h = normalize(v + l);
        let n_h = max(dot(s.normal, h), 0.0);
        let f0 = mix(0.04 + 0.08 * s.wetness, 1.0, s.metallic);
        let shine = glint(max(n_l, 0.0), max(dot(s.normal, v), 1e-3), n_h, max(s.roughness, 0.25));
        let mirror = mix(vec3f(1.0), s.base_colour, s.metallic) * f0;
        let grey = s.base_colour * s.metallic * (0.35 + 0.5 * max(n_l, 0.0));
        return beam.power * (diffuse + mirror * shine + 0.4 * grey) + frame.ambient * (albedo * sky + grey);
    }
    let h = normalize(v + l);
    let roughness = clamp(s.roughness, 0.08, 1.0);
    // Flesh under a film of water hardly mirrors: their refractive indices are 1.38 and 1.33.
    let dielectric = mix(0.04, 0.004, min(2.0 * s.wetness, 1.0));
    let f0 = mix(vec3f(dielectric), s.base_colour, s.metallic);
    let v_h = max(dot(v, h), 0.0);
    let n_v = max(dot(s.normal, v), 1e-3);
    let body = fresnel(v_h, f0) * glint(max(n_l, 0.0), n_v, max(dot(s.normal, h), 0.0), roughness);
    let film_n_v = max(dot(s.film_normal, v), 1e-3);
    let film_n_l = max(dot(s.film_normal, l), 0.0);
    let film_f0 = vec3f(0.035);
    let film_n_h = max(dot(s.film_normal, h), 0.0);
    // Where the film is thin it is rough as what it lies on.
    let film_shine = 0.92 * glint(film_n_l, film_n_v, film_n_h, 0.14) + 0.08 * glint(film_n_l, film_n_v, film_n_h, 0.38);
    let film = s.wetness * fresnel(v_h, film_f0) * film_shine;
    let through = 1.0 - s.wetness * fresnel(film_n_v, film_f0).x;

    let lit = mix(vec3f(beam.lit), vec3f(sqrt(beam.lit), beam.lit, beam.lit), s.flesh);
    var direct = beam.power * (lit * diffuse * through + beam.lit * (body * through + film));
    if FINE {
        // From behind, through what is thin: its own shadow is no shadow, and red goes furthest.
        let behind = max((0.2 - dot(s.mesh_normal, l)) / 1.2, 0.0);
        direct += beam.power * s.flesh * s.through * behind * albedo * vec3f(0.9, 0.30, 0.22);
    }
    // Where the beam does not reach, what it lights nearby shines less.
    let near = 0.55 + 0.45 * beam.lit;
    let mirror = surroundings(reflect(-v, s.normal), beam, roughness);
    let gloss = mirrored(n_v, f0, s.flesh) * (1.0 - 0.35 * roughness);
    let sheen = s.wetness * mirrored(film_n_v, film_f0, s.flesh) * surroundings(reflect(-v, s.film_normal), beam, 0.2);
    return direct + near * s.open * (frame.ambient * albedo * sky * through + mirror * gloss * through + sheen);
}

// In the colour of the light; see `filmic`.
fn exposed(linear: vec3f) -> vec4f {
    let coloured = frame.exposure * linear * vec3f(1.0 + frame.warmth, 1.0, 1.0 - frame.warmth);
    return vec4f(encoded(filmic(coloured)), 1.0);
}
