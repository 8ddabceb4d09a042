// From the image of a pinhole to the picture of a lens and a sensor: where the lens bends rays to, what lies on the way, and
// what the sensor adds. Ids and range go where the colour goes, unmixed.

struct Lens {
    // Focal lengths and principal point of the picture, pixels.
    focal: vec2f,
    centre: vec2f,
    // k1, k2, p1, p2; see `Distortion`.
    distortion: vec4f,
    // What the pinhole's image shows to the left of the picture and above it, pixels.
    margin: vec2f,
    // The picture's, pixels.
    size: vec2f,
    // Whether the lens distorts, and whether anything below changes the colour.
    is_bent: u32,
    is_dim: u32,
    // See `Optics`. The pinhole's image is exposed already.
    vignette: f32,
    exposure: f32,
    shot_noise: f32,
    read_noise: f32,
    smoke_per_m: f32,
    blood: f32,
    fog: f32,
    seed: u32,
    // Counts images, and milliseconds.
    moment: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> lens: Lens;
@group(0) @binding(1) var colour_seen: texture_2d<f32>;
@group(0) @binding(2) var instance_seen: texture_2d<u32>;
@group(0) @binding(3) var range_seen: texture_2d<f32>;

struct Picture {
    @location(0) colour: vec4f,
    @location(1) instance: u32,
    @location(2) range: f32,
}

// Where a ray falls, in units of the focal length.
fn bent(ray: vec2f) -> vec2f {
    let r2 = dot(ray, ray);
    let radial = 1.0 + r2 * (lens.distortion.x + r2 * lens.distortion.y);
    let p = lens.distortion.zw;
    let cross = 2.0 * ray.x * ray.y;
    return ray * radial + cross * p + p.yx * (vec2f(r2) + 2.0 * ray * ray);
}

// The ray that falls at `seen`: Newton's method.
fn straight(seen: vec2f) -> vec2f {
    let k = lens.distortion.xy;
    let p = lens.distortion.zw;
    var ray = seen;
    for (var i = 0; i < 8; i++) {
        let r2 = dot(ray, ray);
        let radial = 1.0 + r2 * (k.x + r2 * k.y);
        let growth = 2.0 * (k.x + 2.0 * k.y * r2);
        let a = radial + growth * ray.x * ray.x + 2.0 * p.x * ray.y + 6.0 * p.y * ray.x;
        let b = growth * ray.x * ray.y + 2.0 * dot(p, ray);
        let d = radial + growth * ray.y * ray.y + 6.0 * p.x * ray.y + 2.0 * p.y * ray.x;
        let off = bent(ray) - seen;
        ray -= vec2f(d * off.x - b * off.y, a * off.y - b * off.x) / (a * d - b * b);
    }
    return ray;
}

fn texel(at: vec2f) -> vec2i {
    return clamp(vec2i(floor(at)), vec2i(0), vec2i(textureDimensions(colour_seen)) - 1);
}

fn load(at: vec2i) -> vec3f {
    let last = vec2i(textureDimensions(colour_seen)) - 1;
    return textureLoad(colour_seen, clamp(at, vec2i(0), last), 0).rgb;
}

// The colour at a place of the pinhole's image: the mean of four texels by their nearness.
fn sharp(at: vec2f) -> vec3f {
    let corner = floor(at - 0.5);
    let part = at - 0.5 - corner;
    let i = vec2i(corner);
    let above = mix(load(i), load(i + vec2i(1, 0)), part.x);
    let below = mix(load(i + vec2i(0, 1)), load(i + vec2i(1, 1)), part.x);
    return mix(above, below, part.y);
}

// The mean over a disc of `radius` pixels: points of a spiral, each of the same share.
fn blurred(at: vec2f, radius: f32) -> vec3f {
    var sum = sharp(at);
    for (var i = 1; i < 24; i++) {
        let turn = 2.3999632 * f32(i);
        let far = radius * sqrt(f32(i) / 23.0);
        sum += load(texel(at + far * vec2f(cos(turn), sin(turn))));
    }
    return sum / 24.0;
}

// PCG in three dimensions (Jarzynski and Olano, 2020).
fn scrambled(at: vec3u) -> vec3u {
    var v = at * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v ^= v >> vec3u(16u);
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    return v;
}

// 0 to 1, three of the kind `kind`, the same in all images of an episode.
fn drawn(kind: u32, index: u32) -> vec3f {
    return vec3f(scrambled(vec3u(lens.seed, kind, index)) >> vec3u(8u)) * 5.9604645e-8;
}

// As many standard deviations from the mean as the sum of a number's four bytes is.
fn deviations(bits: vec3u) -> vec3f {
    let low = (bits & vec3u(255u)) + ((bits >> vec3u(8u)) & vec3u(255u));
    let high = ((bits >> vec3u(16u)) & vec3u(255u)) + (bits >> vec3u(24u));
    return (vec3f(low + high) - 510.0) / 147.79784;
}

// Smooth noise of several sizes, 0 to 1.
fn billows(p: vec2f, seed: i32) -> f32 {
    return 0.57 * noise(p, seed) + 0.28 * noise(2.1 * p + 3.7, seed + 1) + 0.15 * noise(4.3 * p + 9.1, seed + 2);
}

// How much of the smoke's mean is where, 0.2 to 1.8: plumes that rise and curl.
fn plume(p: vec2f) -> f32 {
    let time = 0.001 * f32(lens.moment % 16777216u);
    let origin = 40.0 * drawn(1u, 0u).xy;
    let rising = p + origin + vec2f(0.03, 0.11) * time;
    let curl = vec2f(billows(1.3 * rising, 21), billows(1.3 * rising + 7.0, 31)) - 0.5;
    return 0.2 + 1.6 * smoothstep(0.25, 0.75, billows(1.7 * rising + 1.6 * curl, 41));
}

// How thick the blood on the lens is, 0 to about 1: spots out of focus, uneven at their rims.
fn spots(p: vec2f) -> f32 {
    let count = 1u + u32(5.0 * lens.blood);
    let aspect = lens.size.x / lens.size.y;
    var thick = 0.0;
    for (var i = 0u; i < count; i++) {
        let place = drawn(2u, i);
        let shape = drawn(3u, i);
        let away = p - place.xy * vec2f(aspect, 1.0);
        let radius = (0.035 + 0.085 * place.z * place.z) * (0.5 + 0.8 * lens.blood);
        let tilt = 6.2831853 * shape.x;
        let along = vec2f(cos(tilt), sin(tilt));
        let run = vec2f(dot(away, along), dot(away, vec2f(-along.y, along.x))) * vec2f(1.0, 1.0 + 0.7 * shape.y);
        let uneven = 0.5 * (billows(away / (0.6 * radius) + 50.0 * shape.xz, 51) - 0.5);
        let inside = 1.0 - smoothstep(0.55, 1.15, length(run) / radius + uneven);
        thick = max(thick, inside * (0.45 + 0.55 * shape.z));
    }
    return thick;
}

// How dense the condensate is, 0 to 1: patchy, and last in the middle, which the light warms.
fn mist(p: vec2f, rho2: f32) -> f32 {
    let patchy = smoothstep(0.2, 0.75, billows(2.2 * p + 30.0 * drawn(4u, 0u).xy, 61));
    return clamp(lens.fog * (0.55 + 0.45 * patchy + 0.5 * rho2), 0.0, 1.0);
}

const SMOKE: vec3f = vec3f(0.52, 0.50, 0.485);
const MIST: vec3f = vec3f(0.34, 0.32, 0.31);
// What blood takes of red, green and blue, and what it throws back of the light that falls on it from inside.
const BLOOD: vec3f = vec3f(0.75, 5.5, 6.0);
const BLOOD_GLOW: vec3f = vec3f(0.085, 0.004, 0.003);
// What the light goes through where nothing is near, m.
const FAR_M: f32 = 0.25;

// The colour at `at` of the pinhole's image, as the pixel `pixel` shows it.
fn through(at: vec2f, pixel: vec2f, ray: vec2f, range: f32) -> vec3f {
    let p = pixel / lens.size.y;
    let corner = max(lens.centre, lens.size - lens.centre);
    let rho = (pixel - lens.centre) / length(corner);
    let rho2 = dot(rho, rho);
    var misty = 0.0;
    if lens.fog > 0.0 { misty = mist(p, rho2); }
    var bloody = 0.0;
    if lens.blood > 0.0 { bloody = spots(p); }
    let radius = lens.size.y * (0.018 * misty + 0.035 * min(bloody, 0.6));
    var seen: vec3f;
    if radius > 0.5 { seen = blurred(at, radius); } else { seen = sharp(at); }
    var light = unfilmic(decoded(seen));
    if lens.smoke_per_m > 0.0 {
        let way = select(range, FAR_M, range <= 0.0) * length(vec3f(ray, 1.0));
        let left = exp(-lens.smoke_per_m * way * plume(p));
        light = mix(lens.exposure * SMOKE, light, left);
    }
    light = mix(light, lens.exposure * MIST + 0.25 * light, 0.6 * misty);
    light = light * exp(-bloody * BLOOD) + lens.exposure * BLOOD_GLOW * (1.0 - exp(-2.0 * bloody));
    light *= 1.0 - lens.vignette * rho2;
    let mean = min(light, vec3f(8.0));
    let spread = sqrt(lens.shot_noise * lens.shot_noise * mean + lens.read_noise * lens.read_noise);
    let bits = scrambled(vec3u(vec2u(pixel), lens.seed ^ (lens.moment * 0x9e3779b1u)));
    return encoded(filmic(light + spread * deviations(bits)));
}

// A triangle over the whole picture.
@vertex
fn picture_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let x = f32(i32(index & 1u) * 4 - 1);
    let y = f32(i32(index >> 1u) * 4 - 1);
    return vec4f(x, y, 0.0, 1.0);
}

@fragment
fn picture_fragment(@builtin(position) clip: vec4f) -> Picture {
    var ray = (clip.xy - lens.centre) / lens.focal;
    var at = clip.xy + lens.margin;
    if lens.is_bent != 0u {
        ray = straight(ray);
        at = ray * lens.focal + lens.centre + lens.margin;
    }
    let nearest = texel(at);
    let range = textureLoad(range_seen, nearest, 0).x;
    var colour: vec3f;
    if lens.is_dim != 0u { colour = through(at, clip.xy, ray, range); } else { colour = sharp(at); }
    return Picture(vec4f(colour, 1.0), textureLoad(instance_seen, nearest, 0).x, range);
}
