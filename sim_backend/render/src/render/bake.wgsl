// What the patterned surfaces look like, painted once: albedo and hollows in one image, heights in another, then slopes.
// Lengths are millimetres on the surface.

// See `Pattern` in `visual.rs`.
override PATTERN: u32 = 5;

struct Paint {
    base_colour: vec3f,
    // 1, which the compiler does not know: a software rasteriser compiles loops that it can't unroll in a fraction of the time.
    one: i32,
    // Side of the image, texels and mm.
    size_px: f32,
    size_mm: f32,
    // Where on the endless pattern its middle is, mm.
    middle_mm: vec2f,
}

@group(0) @binding(0) var<uniform> paint: Paint;
@group(1) @binding(0) var source_albedo: texture_2d<f32>;
@group(1) @binding(1) var source_relief: texture_2d<f32>;

struct Look {
    colour: vec3f,
    // 1 in the open, less in hollows.
    open: f32,
    // Height of the flesh and of the film of fluid on it, mm.
    height: vec2f,
}

struct Painted {
    @location(0) albedo: vec4f,
    @location(1) relief: vec4f,
}

// A triangle that covers the image.
@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let x = f32(i32(index & 1u) * 4 - 1);
    let y = f32(i32(index >> 1u) * 4 - 1);
    return vec4f(x, y, 0.0, 1.0);
}

// Noise of several octaves, each with half the share of the one before; mean 0.5.
fn octaves(p: vec2f, seed: i32, count: i32) -> f32 {
    var sum = 0.0;
    var all = 0.0;
    var q = p;
    var share = 1.0;
    for (var octave = 0; octave < count * paint.one; octave++) {
        sum += share * noise(q, seed + octave);
        all += share;
        q = vec2f(0.8 * q.x - 0.6 * q.y, 0.6 * q.x + 0.8 * q.y) * 2.03;
        share *= 0.5;
    }
    return sum / all;
}

fn clouds(p: vec2f, seed: i32) -> f32 {
    return octaves(p, seed, 5);
}

// The same without what is small.
fn swell(p: vec2f, seed: i32) -> f32 {
    return octaves(p, seed, 2);
}

// Cells about scattered points: distances to the nearest and the second one, and a number of the cell, 0 to 1.
fn cells(p: vec2f, seed: i32) -> vec3f {
    let home = floor(p);
    var nearest = vec3f(8.0, 8.0, 0.0);
    for (var dy = -paint.one; dy <= paint.one; dy++) {
        for (var dx = -paint.one; dx <= paint.one; dx++) {
            let cell = vec2i(home) + vec2i(dx, dy);
            let scatter = vec2f(lattice(vec3i(cell, seed)), lattice(vec3i(cell, seed + 1)));
            let distance = length(vec2f(cell) + 0.1 + 0.8 * scatter - p);
            if distance < nearest.x {
                nearest = vec3f(distance, nearest.x, lattice(vec3i(cell, seed + 2)));
            } else if distance < nearest.y {
                nearest.y = distance;
            }
        }
    }
    return nearest;
}

// What is seen of the vessels at a texel, see `vessels.wgsl`: some lie deeper than others, and are seen less.
fn vessels(p: vec2f, at: vec2i) -> vec3f {
    let near = 0.45 + 0.55 * smoothstep(0.36, 0.58, swell(p / 15.0, 31));
    return near * textureLoad(source_albedo, at, 0).rgb;
}

// Rivulets of the film of fluid along wandering lines, whatever way is down: some `size` mm apart and several times as long; 0 to 1.
fn flow(p: vec2f, size: f32, seed: i32) -> f32 {
    let wander = vec2f(swell(p / 19.0, seed) - 0.5, swell(p / 19.0, seed + 5) - 0.5);
    let q = p + 14.0 * wander;
    let wide = noise(vec2f(0.8 * q.x + 0.6 * q.y, 4.0 * (0.8 * q.y - 0.6 * q.x)) / (4.0 * size), seed + 10);
    let narrow = noise(vec2f(0.8 * q.x + 0.6 * q.y, 4.0 * (0.8 * q.y - 0.6 * q.x)) / (1.9 * size), seed + 11);
    return 0.7 * wide + 0.3 * narrow;
}

// Light that is taken away by blood in vessels `share` deep.
fn bled(colour: vec3f, share: f32, deep: f32) -> vec3f {
    return colour * exp(-share * mix(vec3f(0.50, 2.0, 1.8), vec3f(1.15, 1.75, 1.0), deep));
}

// The same under vessels as `vessels` has them: veins are the bluer the wider, arteries are red.
fn perfused(colour: vec3f, seen: vec3f, strength: f32) -> vec3f {
    return bled(bled(colour, strength * seen.r, seen.b), 1.1 * strength * seen.g, 0.0);
}

// Muscle and the wall of a hollow organ: pink, mottled, with faint fibres under the serosa, and its vessels.
fn muscle(p: vec2f, at: vec2i) -> Look {
    let wander = vec2f(swell(p / 21.0, 601) - 0.5, swell(p / 21.0, 611) - 0.5);
    let q = vec2f(0.97 * p.x + 0.24 * p.y, -0.24 * p.x + 0.97 * p.y) + 13.0 * wander;
    let fibre = clouds(vec2f(q.x / 9.0, q.y / 0.9), 620) - 0.5;
    let broad = swell(p / 24.0, 630) - 0.5;
    let blotch = clouds(p / 5.5, 640) - 0.5;
    let grain = swell(p / 1.1, 650) - 0.5;
    let pale = smoothstep(0.50, 0.72, clouds(p / 12.0, 660));
    // Capillaries, too fine to be told apart.
    let blush = smoothstep(0.42, 0.66, clouds(p / 3.4 + 2.0 * wander, 670));
    let seen = vessels(p, at);
    var colour = paint.base_colour * vec3f(1.08, 1.26, 1.16);
    colour *= 1.0 + 0.50 * broad + 0.22 * blotch + 0.30 * fibre + 0.12 * grain;
    colour = mix(colour, vec3f(0.50, 0.19, 0.135), 0.30 * pale);
    colour = bled(colour, 0.16 * blush, 0.0);
    colour = perfused(colour, seen, 0.62);
    let waves = 2.2 * clouds(p / 21.0, 860) + 0.34 * clouds(p / 5.0, 861);
    let height = waves + 0.055 * fibre + 0.06 * seen.b + 0.02 * seen.g + 0.03 * grain;
    let film = waves + 0.05 * seen.b + 0.15 * flow(p, 2.1, 870) + 0.020 * noise(p / 1.0, 871);
    return Look(colour, 1.0, vec2f(height, film));
}

// Liver: a brown capsule, smooth and tense, lobules hardly seen.
fn liver(p: vec2f, at: vec2i) -> Look {
    let bent = p + 0.9 * vec2f(noise(p / 2.0, 900) - 0.5, noise(p / 2.0, 901) - 0.5);
    let lobule = cells(bent / 1.25, 910);
    let rim = 1.0 - smoothstep(0.0, 0.35, lobule.y - lobule.x);
    let broad = swell(p / 26.0, 920) - 0.5;
    let mottle = clouds(p / 8.0, 921) - 0.5;
    let grain = swell(p / 1.4, 930) - 0.5;
    let seen = vessels(p, at);
    var colour = paint.base_colour * vec3f(1.30, 1.32, 1.35);
    colour *= 1.0 + 0.7 * broad + 0.36 * mottle + 0.12 * grain + 0.14 * (lobule.z - 0.5) + 0.12 * rim;
    colour = mix(colour, paint.base_colour * vec3f(1.9, 3.0, 2.4), 0.22 * smoothstep(0.05, 0.28, mottle));
    colour = perfused(colour, seen, 0.26);
    let waves = 1.9 * clouds(p / 30.0, 980) + 0.10 * clouds(p / 7.0, 981);
    let height = waves + 0.012 * smoothstep(0.0, 0.6, lobule.y - lobule.x) + 0.012 * grain;
    let film = waves + 0.05 * flow(p, 4.5, 975) + 0.010 * noise(p / 1.6, 991);
    return Look(colour, 1.0, vec2f(height, film));
}

// Fat: soft yellow lobules of several sizes under a shining membrane, and pink between.
fn fat(p: vec2f, at: vec2i) -> Look {
    let bent = p + 3.4 * vec2f(swell(p / 7.0, 1000) - 0.5, swell(p / 7.0, 1001) - 0.5)
        + 0.7 * vec2f(noise(p / 1.3, 1002) - 0.5, noise(p / 1.3, 1003) - 0.5);
    let large = cells(bent / 7.5, 1010);
    let small = cells(bent / 2.4, 1020);
    // Lobules are whole, so islands of fat have outlines of lobules.
    let fatty = smoothstep(0.44, 0.55, clouds(p / 33.0, 1030) + 0.07 * (large.z - 0.5) + 0.03 * (small.z - 0.5)
        - 0.05 * (1.0 - smoothstep(0.0, 0.5, large.y - large.x)));
    let broad = swell(p / 15.0, 1040) - 0.5;
    let crease = 1.0 - smoothstep(0.0, 0.45, large.y - large.x);
    let seen = vessels(p, at);
    var colour = vec3f(0.34, 0.095, 0.072) * (1.0 + 0.9 * broad);
    let lobules = paint.base_colour * vec3f(1.00, 1.06, 1.45) * (0.95 + 0.06 * small.z + 0.14 * large.z + 0.5 * broad - 0.16 * crease);
    colour = mix(colour, lobules, fatty);
    colour = perfused(colour, seen, 0.55);
    let round = fatty * (0.70 * smoothstep(0.0, 0.9, large.y - large.x) + 0.08 * smoothstep(0.0, 0.8, small.y - small.x));
    let height = round + 4.0 * clouds(p / 33.0, 1090) + 0.12 * seen.b;
    return Look(colour, 1.0 - 0.10 * crease * fatty, vec2f(height, height + 0.07 * noise(p / 1.6, 1095)));
}

// Silicone cast to look like skin: even, matt, a little dusty.
fn pad(p: vec2f) -> Look {
    let broad = swell(p / 30.0, 1100) - 0.5;
    let speck = swell(p / 0.7, 1110) - 0.5;
    let dent = clouds(p / 3.0, 1120) - 0.5;
    var colour = paint.base_colour * vec3f(1.12, 1.16, 1.2) * (1.0 + 0.10 * broad + 0.06 * speck);
    let height = 0.05 * dent + 0.012 * speck;
    return Look(colour, 1.0, vec2f(height, height));
}

// A sheet of peritoneum: pale, with the vessels that run in it and a little fat along them.
fn membrane(p: vec2f, at: vec2i) -> Look {
    let broad = swell(p / 17.0, 1260) - 0.5;
    let blotch = clouds(p / 3.6, 1270) - 0.5;
    let fatty = smoothstep(0.55, 0.75, clouds(p / 8.0, 1280));
    let seen = vessels(p, at);
    var colour = paint.base_colour * vec3f(0.76, 0.47, 0.45) * (1.0 + 0.5 * broad + 0.24 * blotch);
    colour = mix(colour, vec3f(0.58, 0.33, 0.15), 0.18 * fatty);
    colour = perfused(colour, seen, 0.60);
    let waves = 1.1 * clouds(p / 9.0, 1290) + 0.20 * fatty;
    let height = waves + 0.06 * seen.b + 0.02 * seen.g + 0.05 * blotch;
    let film = waves + 0.05 * seen.b + 0.09 * flow(p, 1.5, 1310) + 0.02 * noise(p / 0.7, 1296);
    return Look(colour, 1.0, vec2f(height, film));
}

// A surgical drape: plain weave in soft folds.
fn cloth(p: vec2f) -> Look {
    let bent = p + 1.5 * vec2f(noise(p / 9.0, 500) - 0.5, noise(p / 9.0, 501) - 0.5);
    let warp = 0.5 + 0.5 * cos(bent.x * 5.0);
    let weft = 0.5 + 0.5 * cos(bent.y * 5.0);
    let over = 0.5 + 0.5 * cos(0.5 * (bent.x + bent.y) * 5.0);
    let thread = mix(warp, weft, over);
    let wear = clouds(p / 12.0, 510) - 0.5;
    let fuzz = noise(p * 3.0, 520) - 0.5;
    let fold = 5.0 * clouds(vec2f(p.x + 0.5 * p.y, 0.8 * p.y - 0.4 * p.x) / 45.0, 530);
    let colour = paint.base_colour * (0.75 + 0.35 * thread + 0.4 * wear + 0.25 * fuzz);
    return Look(colour, 0.8 + 0.2 * thread, vec2f(0.06 * thread + fold, fold));
}

// Step one: colours and heights.
@fragment
fn look(@builtin(position) at: vec4f) -> Painted {
    let p = (at.xy / paint.size_px - 0.5) * paint.size_mm + paint.middle_mm;
    var found: Look;
    switch PATTERN {
        case 1u: { found = muscle(p, vec2i(at.xy)); }
        case 2u: { found = liver(p, vec2i(at.xy)); }
        case 3u: { found = fat(p, vec2i(at.xy)); }
        case 4u: { found = pad(p); }
        case 6u: { found = membrane(p, vec2i(at.xy)); }
        default: { found = cloth(p); }
    }
    return Painted(vec4f(clamp(found.colour, vec3f(0.0), vec3f(1.0)), found.open), vec4f(found.height, 0.0, 0.0));
}

fn height_at(at: vec2i) -> vec2f {
    let last = vec2i(textureDimensions(source_relief)) - 1;
    return textureLoad(source_relief, clamp(at, vec2i(0), last), 0).xy;
}

// Step two: slopes of flesh and film, stored about 0.5; see `slopes` in `surface.wgsl`.
@fragment
fn slope(@builtin(position) at: vec4f) -> Painted {
    let here = vec2i(at.xy);
    let step_mm = 2.0 * paint.size_mm / paint.size_px;
    let along_u = (height_at(here + vec2i(1, 0)) - height_at(here - vec2i(1, 0))) / step_mm;
    let along_v = (height_at(here + vec2i(0, 1)) - height_at(here - vec2i(0, 1))) / step_mm;
    let stored = 0.5 + 0.5 * clamp(vec4f(along_u.x, along_v.x, along_u.y, along_v.y), vec4f(-1.0), vec4f(1.0));
    return Painted(textureLoad(source_albedo, here, 0), stored);
}

// Step three, once a level: the mean of four texels.
@fragment
fn halve(@builtin(position) at: vec4f) -> Painted {
    let first = 2 * vec2i(at.xy);
    var albedo = vec4f(0.0);
    var relief = vec4f(0.0);
    for (var y = 0; y < 2; y++) {
        for (var x = 0; x < 2; x++) {
            albedo += 0.25 * textureLoad(source_albedo, first + vec2i(x, y), 0);
            relief += 0.25 * textureLoad(source_relief, first + vec2i(x, y), 0);
        }
    }
    return Painted(albedo, relief);
}
