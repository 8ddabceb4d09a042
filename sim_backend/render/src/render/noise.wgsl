// Noise from integer arithmetic, so the same on every device.

// 0 to 1 from a lattice point.
fn lattice(p: vec3i) -> f32 {
    let u = bitcast<vec3u>(p);
    var h = (u.x * 0x9e3779b1u) ^ (u.y * 0x85ebca77u) ^ (u.z * 0xc2b2ae3du);
    h = (h ^ (h >> 15u)) * 0x2c1b3c6du;
    h = h ^ (h >> 12u);
    return f32(h >> 8u) * 5.9604645e-8;
}

// Smooth noise in the plane, mean 0.5; `seed` chooses among independent fields.
fn noise(p: vec2f, seed: i32) -> f32 {
    let cell = floor(p);
    let i = vec2i(cell);
    let f = p - cell;
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let low = mix(lattice(vec3i(i, seed)), lattice(vec3i(i + vec2i(1, 0), seed)), s.x);
    let high = mix(lattice(vec3i(i + vec2i(0, 1), seed)), lattice(vec3i(i + vec2i(1, 1), seed)), s.x);
    return mix(low, high, s.y);
}
