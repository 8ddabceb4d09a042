// From the brightness of things to the bytes of a picture, and back.

// sRGB's encoding, done here since samples of a pixel are then cheaper to keep.
fn encoded(x: vec3f) -> vec3f {
    return select(1.055 * pow(x, vec3f(1.0 / 2.4)) - 0.055, 12.92 * x, x < vec3f(0.0031308));
}

fn decoded(x: vec3f) -> vec3f {
    return select(pow((x + 0.055) / 1.055, vec3f(2.4)), x / 12.92, x < vec3f(0.04045));
}

// Filmic response: a toe, a middle grey that stays where it is, a long shoulder. The three numbers were fitted to
// 0.02 -> 0.012, 0.18 -> 0.20, 1 -> 0.72, 4 -> 0.935, with the ends fixed at 0 and 1.
fn filmic(linear: vec3f) -> vec3f {
    let x = max(linear, vec3f(0.0));
    return x * (x + 0.0593) / (x * (x + 0.3833) + 0.1126);
}

// Its inverse. What is white comes back as 64 at most: nothing tells how bright it was.
fn unfilmic(response: vec3f) -> vec3f {
    let y = clamp(response, vec3f(0.0), vec3f(0.995));
    let half = 0.5 * (0.3833 * y - 0.0593);
    return (half + sqrt(half * half + 0.1126 * y * (1.0 - y))) / (1.0 - y);
}
