// The same surfaces for pictures that people look at: what lies under a thin wet membrane, seen through it.

// Vessels of one size: the borders of cells of `size` mm, bent, in places; `width` in mm. Their borders fade where the light falls through.
fn vessel_net(p: vec2f, size: f32, width: f32, seed: i32) -> f32 {
    let far = size * 0.55;
    let bend = far * vec2f(clouds(p / (1.3 * size), seed) - 0.5, clouds(p / (1.3 * size), seed + 7) - 0.5)
        + 0.16 * size * vec2f(noise(p / (0.24 * size), seed + 14) - 0.5, noise(p / (0.24 * size), seed + 15) - 0.5);
    let cell = cells((p + 1.35 * bend) / size, seed + 20);
    let border = 0.5 * size * (cell.y - cell.x);
    let thick = width * (0.45 + 1.1 * noise(p / (1.7 * size), seed + 30));
    let here = smoothstep(0.42, 0.66, clouds(p / (2.2 * size), seed + 31));
    return here * (1.0 - smoothstep(0.35 * thick, thick + 0.06, border));
}

// Light that is taken away by blood in vessels `share` deep.
fn bled(colour: vec3f, share: f32, deep: f32) -> vec3f {
    return colour * exp(-share * mix(vec3f(0.55, 2.3, 2.0), vec3f(1.25, 1.9, 1.05), deep));
}

// The wall of a hollow organ: pink, mottled, with fibres that one guesses under the serosa, and its vessels.
fn organ_fine(p: vec2f) -> Look {
    let wander = vec2f(clouds(p / 21.0, 601) - 0.5, clouds(p / 21.0, 611) - 0.5);
    let q = vec2f(0.97 * p.x + 0.24 * p.y, -0.24 * p.x + 0.97 * p.y) + 13.0 * wander;
    let fibre = clouds(vec2f(q.x / 9.0, q.y / 0.9), 620) - 0.5;
    let broad = clouds(p / 24.0, 630) - 0.5;
    let blotch = clouds(p / 5.5, 640) - 0.5;
    let grain = clouds(p / 1.1, 650) - 0.5;
    let pale = smoothstep(0.50, 0.72, clouds(p / 12.0, 660));
    let veins = vessel_net(p, 27.0, 0.70, 700);
    let arteries = vessel_net(p + 31.0, 15.0, 0.34, 740);
    let fine = vessel_net(p + 11.0, 4.2, 0.17, 780);
    let finest = vessel_net(p + 5.0, 1.9, 0.10, 820);
    var colour = paint.base_colour * vec3f(1.10, 1.35, 1.25);
    colour *= 1.0 + 0.55 * broad + 0.26 * blotch + 0.30 * fibre + 0.14 * grain;
    colour = mix(colour, vec3f(0.50, 0.19, 0.135), 0.34 * pale);
    colour = bled(colour, 0.50 * veins, 1.0);
    colour = bled(colour, 0.55 * arteries, 0.0);
    colour = bled(colour, 0.42 * fine + 0.20 * finest, 0.1);
    let waves = 2.2 * clouds(p / 21.0, 860) + 0.34 * clouds(p / 5.0, 861);
    let height = waves + 0.055 * fibre + 0.10 * veins + 0.05 * arteries + 0.03 * grain;
    let film = waves + 0.16 * noise(p / 2.6, 870) + 0.055 * noise(p / 1.0, 871) + 0.022 * noise(p / 0.45, 872);
    return Look(colour, 1.0, vec2f(height, film));
}

// Liver: a brown capsule, smooth and tense, lobules hardly seen.
fn liver_fine(p: vec2f) -> Look {
    let bent = p + 0.9 * vec2f(noise(p / 2.0, 900) - 0.5, noise(p / 2.0, 901) - 0.5);
    let lobule = cells(bent / 1.25, 910);
    let rim = 1.0 - smoothstep(0.0, 0.35, lobule.y - lobule.x);
    let broad = clouds(p / 26.0, 920) - 0.5;
    let mottle = clouds(p / 8.0, 921) - 0.5;
    let grain = clouds(p / 1.4, 930) - 0.5;
    let veins = vessel_net(p, 23.0, 0.5, 940);
    let fine = vessel_net(p + 17.0, 5.0, 0.14, 960);
    var colour = paint.base_colour * vec3f(1.55, 1.75, 1.60);
    colour *= 1.0 + 0.7 * broad + 0.5 * mottle + 0.24 * grain + 0.18 * (lobule.z - 0.5) + 0.16 * rim;
    colour = mix(colour, paint.base_colour * vec3f(2.0, 3.6, 2.7), 0.25 * smoothstep(0.05, 0.28, mottle));
    colour = bled(colour, 0.35 * veins, 0.6);
    colour = bled(colour, 0.30 * fine, 0.2);
    let waves = 1.9 * clouds(p / 30.0, 980) + 0.10 * clouds(p / 7.0, 981);
    let height = waves + 0.012 * smoothstep(0.0, 0.6, lobule.y - lobule.x) + 0.012 * grain;
    let film = waves + 0.10 * noise(p / 3.4, 990) + 0.030 * noise(p / 1.3, 991) + 0.012 * noise(p / 0.5, 992);
    return Look(colour, 1.0, vec2f(height, film));
}

// Fat: soft yellow lobules of several sizes under a shining membrane, and pink between.
fn fat_fine(p: vec2f) -> Look {
    let bent = p + 3.4 * vec2f(clouds(p / 7.0, 1000) - 0.5, clouds(p / 7.0, 1001) - 0.5);
    let large = cells(bent / 7.5, 1010);
    let small = cells(bent / 2.4, 1020);
    let fatty = smoothstep(0.38, 0.60, clouds(p / 33.0, 1030));
    let broad = clouds(p / 15.0, 1040) - 0.5;
    let crease = 1.0 - smoothstep(0.0, 0.45, large.y - large.x);
    let veins = vessel_net(p, 21.0, 0.7, 1050);
    let fine = vessel_net(p + 9.0, 6.0, 0.2, 1070);
    var colour = vec3f(0.42, 0.125, 0.095) * (1.0 + 0.9 * broad);
    let lobules = paint.base_colour * vec3f(1.05, 1.12, 1.25) * (0.95 + 0.10 * small.z + 0.10 * large.z + 0.5 * broad - 0.10 * crease);
    colour = mix(colour, lobules, fatty);
    colour = bled(colour, 0.6 * veins, 0.7);
    colour = bled(colour, 0.45 * fine, 0.1);
    let round = fatty * (0.55 * smoothstep(0.0, 0.9, large.y - large.x) + 0.16 * smoothstep(0.0, 0.8, small.y - small.x));
    let height = round + 4.0 * clouds(p / 33.0, 1090);
    return Look(colour, 1.0 - 0.10 * crease * fatty, vec2f(height, height + 0.07 * noise(p / 1.6, 1095)));
}

// Silicone cast to look like skin: even, matt, a little dusty.
fn pad_fine(p: vec2f) -> Look {
    let broad = clouds(p / 30.0, 1100) - 0.5;
    let speck = clouds(p / 0.7, 1110) - 0.5;
    let dent = clouds(p / 3.0, 1120) - 0.5;
    var colour = paint.base_colour * vec3f(1.12, 1.16, 1.2) * (1.0 + 0.10 * broad + 0.06 * speck);
    let height = 0.05 * dent + 0.012 * speck;
    return Look(colour, 1.0, vec2f(height, height));
}

// A sheet of peritoneum: pale, with the vessels that run in it and a little fat along them.
fn membrane_fine(p: vec2f) -> Look {
    let veins = vessel_net(p + 3.0, 25.0, 0.55, 1200);
    let arteries = vessel_net(p + 23.0, 13.0, 0.28, 1220);
    let fine = vessel_net(p + 13.0, 4.6, 0.13, 1240);
    let broad = clouds(p / 17.0, 1260) - 0.5;
    let blotch = clouds(p / 3.6, 1270) - 0.5;
    let fatty = smoothstep(0.55, 0.75, clouds(p / 8.0, 1280));
    var colour = paint.base_colour * vec3f(0.86, 0.62, 0.60) * (1.0 + 0.5 * broad + 0.24 * blotch);
    colour = mix(colour, vec3f(0.58, 0.33, 0.15), 0.26 * fatty);
    colour = bled(colour, 0.45 * veins, 0.8);
    colour = bled(colour, 0.42 * arteries, 0.0);
    colour = bled(colour, 0.28 * fine, 0.1);
    let waves = 1.1 * clouds(p / 9.0, 1290) + 0.20 * fatty;
    let height = waves + 0.12 * veins + 0.05 * arteries + 0.05 * blotch;
    let film = waves + 0.08 * noise(p / 1.8, 1295) + 0.03 * noise(p / 0.7, 1296);
    return Look(colour, 1.0, vec2f(height, film));
}

// Step one: colours and heights.
@fragment
fn look_fine(@builtin(position) at: vec4f) -> Painted {
    let p = (at.xy / paint.size_px - 0.5) * paint.size_mm;
    var found: Look;
    switch paint.pattern {
        case 1u: { found = organ_fine(p); }
        case 2u: { found = liver_fine(p); }
        case 3u: { found = fat_fine(p); }
        case 4u: { found = pad_fine(p); }
        case 6u: { found = membrane_fine(p); }
        default: { found = cloth(p); }
    }
    return Painted(vec4f(clamp(found.colour, vec3f(0.0), vec3f(1.0)), found.open), vec4f(found.height, 0.0, 0.0));
}
