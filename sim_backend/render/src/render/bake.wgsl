// What the patterned surfaces look like, painted once: albedo and hollows in one image, heights in another, then slopes.
// Lengths are millimetres on the surface.

struct Paint {
    base_colour: vec3f,
    // See `Pattern` in `visual.rs`.
    pattern: u32,
    // Side of the image, texels and mm.
    size_px: f32,
    size_mm: f32,
    unused_0: f32,
    unused_1: f32,
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

// Five octaves, mean 0.5.
fn clouds(p: vec2f, seed: i32) -> f32 {
    var sum = 0.0;
    var q = p;
    var share = 0.516;
    for (var octave = 0; octave < 5; octave++) {
        sum += share * noise(q, seed + octave);
        q = vec2f(0.8 * q.x - 0.6 * q.y, 0.6 * q.x + 0.8 * q.y) * 2.03;
        share *= 0.5;
    }
    return sum;
}

// Cells about scattered points: distances to the nearest and the second one, and a number of the cell, 0 to 1.
fn cells(p: vec2f, seed: i32) -> vec3f {
    let home = floor(p);
    var nearest = vec3f(8.0, 8.0, 0.0);
    for (var dy = -1; dy <= 1; dy++) {
        for (var dx = -1; dx <= 1; dx++) {
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

// How much a thin line along the middle of a field covers `p`: `steep` is about the field's slope.
fn line(field: f32, width: f32) -> f32 {
    return 1.0 - smoothstep(0.4 * width, width, abs(field - 0.5));
}

// A tree of vessels: thick and rare, with thinner ones between.
fn vessels(p: vec2f, seed: i32) -> f32 {
    let q = p + 5.0 * vec2f(clouds(p / 11.0, seed) - 0.5, clouds(p / 11.0, seed + 20) - 0.5);
    let trunk = line(noise(q / 26.0, seed + 40), 0.013) * smoothstep(0.35, 0.5, noise(p / 30.0, seed + 41));
    let branch = line(noise(q / 13.0, seed + 50), 0.018) * smoothstep(0.40, 0.55, noise(p / 17.0, seed + 51));
    let twig = line(noise(q / 6.0, seed + 60), 0.022) * smoothstep(0.45, 0.65, noise(p / 9.0, seed + 61));
    return max(trunk, max(0.75 * branch, 0.45 * twig));
}

// Muscle: bundles of fibres along x, pale fascia between them, marbled fat, a few vessels on top.
fn muscle(p: vec2f) -> Look {
    let wander = vec2f(clouds(p / 26.0, 1) - 0.5, clouds(p / 26.0, 11) - 0.5);
    let q = vec2f(0.985 * p.x + 0.17 * p.y, -0.17 * p.x + 0.985 * p.y) + vec2f(4.0, 9.0) * wander;
    let bundle = cells(vec2f(q.x / 34.0, q.y / 3.4), 100);
    let gap = 1.0 - smoothstep(0.02, 0.20, bundle.y - bundle.x);
    let strand = noise(vec2f(q.x / 5.0, q.y * 1.5), 120);
    let fibre = noise(vec2f(q.x / 3.0, q.y * 3.7), 121);
    let streaks = 0.5 * strand + 0.5 * fibre;
    let fascia = max(
        gap * smoothstep(0.30, 0.62, clouds(p / 7.0, 130)),
        0.8 * smoothstep(0.64, 0.80, clouds(vec2f(q.x / 12.0, q.y / 1.6), 140)),
    );
    let vessel = vessels(p, 150);
    let broad = clouds(p / 22.0, 160) - 0.5;
    var colour = paint.base_colour * (0.62 + 0.46 * bundle.z + 0.95 * (streaks - 0.5) + 0.9 * broad + 0.15);
    colour = mix(colour, vec3f(0.58, 0.31, 0.25), 0.48 * fascia);
    colour = mix(colour, paint.base_colour * vec3f(0.34, 0.22, 0.50), 0.85 * vessel);
    let round = smoothstep(0.0, 0.55, bundle.y - bundle.x);
    let height = 0.36 * round + 0.10 * strand + 0.05 * fibre + 0.9 * clouds(p / 16.0, 170) + 0.10 * vessel;
    let film = 0.26 * round + 0.09 * strand + 1.1 * clouds(p / 16.0, 170) + 0.10 * noise(p / 1.3, 180);
    return Look(colour, 1.0 - 0.45 * gap * (1.0 - fascia), vec2f(height, film));
}

// Liver: a smooth dark capsule over faint lobules, a little mottled.
fn liver(p: vec2f) -> Look {
    let bent = p + 0.8 * vec2f(noise(p / 2.0, 200) - 0.5, noise(p / 2.0, 201) - 0.5);
    let lobule = cells(bent / 1.7, 210);
    let rim = 1.0 - smoothstep(0.0, 0.30, lobule.y - lobule.x);
    let mottle = clouds(p / 14.0, 220) - 0.5;
    let grain = clouds(p / 2.2, 230) - 0.5;
    let vein = vessels(p * 1.1 + 40.0, 240);
    var colour = paint.base_colour * (1.0 + 1.1 * mottle + 0.5 * grain + 0.35 * (lobule.z - 0.5) + 0.25 * rim);
    colour = mix(colour, paint.base_colour * vec3f(1.35, 1.8, 1.6), 0.35 * smoothstep(0.10, 0.3, mottle));
    colour = mix(colour, paint.base_colour * vec3f(0.45, 0.35, 0.60), 0.45 * vein);
    let waves = 1.8 * clouds(p / 30.0, 250);
    let height = waves + 0.04 * smoothstep(0.0, 0.6, lobule.y - lobule.x) + 0.03 * grain;
    let film = waves + 0.42 * noise(p / 6.5, 260) + 0.045 * noise(p / 2.2, 261) + 0.010 * noise(p / 0.8, 262);
    return Look(colour, 1.0 - 0.12 * rim, vec2f(height, film));
}

// The lining of a body: pink and red, with yellow fat in places and vessels under it.
fn fat(p: vec2f) -> Look {
    let bent = p + 3.0 * vec2f(noise(p / 6.0, 300) - 0.5, noise(p / 6.0, 301) - 0.5);
    let lobule = cells(bent / 7.0, 310);
    let crease = 1.0 - smoothstep(0.0, 0.40, lobule.y - lobule.x);
    let fatty = smoothstep(0.46, 0.66, clouds(p / 30.0, 320));
    let vessel = vessels(p, 340);
    let broad = clouds(p / 12.0, 330) - 0.5;
    var colour = vec3f(0.34, 0.075, 0.055) * (1.0 + 1.2 * broad);
    colour = mix(colour, paint.base_colour * (0.8 + 0.3 * lobule.z + 0.4 * broad - 0.35 * crease), fatty);
    colour = mix(colour, vec3f(0.16, 0.012, 0.02), 0.7 * vessel);
    let round = fatty * sqrt(clamp(lobule.y - lobule.x, 0.0, 1.0));
    let height = 0.9 * round + 5.0 * clouds(p / 30.0, 350);
    return Look(colour, 1.0 - 0.35 * crease * fatty, vec2f(height, height + 0.10 * noise(p / 2.2, 360)));
}

// Skin and the silicone that stands for it: fine creases, pores, a faint flush.
fn skin(p: vec2f) -> Look {
    let crease = cells(p / vec2f(1.5, 1.1) + 0.6 * noise(p / 2.0, 400), 410);
    let fine = cells(p / 0.7, 420);
    let furrow = 1.0 - smoothstep(0.0, 0.25, crease.y - crease.x);
    let pore = 1.0 - smoothstep(0.05, 0.28, fine.x);
    let flush = clouds(p / 19.0, 430) - 0.5;
    let speck = clouds(p / 1.7, 440) - 0.5;
    var colour = paint.base_colour * (1.0 + 0.28 * speck - 0.10 * furrow - 0.10 * pore);
    colour *= vec3f(1.0) + flush * vec3f(0.25, 0.6, 0.6);
    let height = 0.040 * smoothstep(0.0, 0.4, crease.y - crease.x) - 0.018 * pore + 0.5 * clouds(p / 15.0, 450);
    return Look(colour, 1.0 - 0.15 * furrow, vec2f(height, height));
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
    let p = (at.xy / paint.size_px - 0.5) * paint.size_mm;
    var found: Look;
    switch paint.pattern {
        case 1u: { found = muscle(p); }
        case 2u: { found = liver(p); }
        case 3u: { found = fat(p); }
        case 4u, 6u: { found = skin(p); }
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
