// Vessels of a painted surface, a quadrangle a stretch: how much of a vein is seen in red, of an artery in green, and in blue that of veins
// as far as they are wide. See `vessels.rs`.

struct Vessel {
    @builtin(position) clip: vec4f,
    @location(0) at_mm: vec2f,
    @location(1) @interpolate(flat) ends_mm: vec4f,
    @location(2) @interpolate(flat) radius_mm: f32,
    @location(3) @interpolate(flat) shares: vec2f,
    @location(4) @interpolate(flat) is_artery: f32,
}

// How far the edge of a vein is blurred by what lies over it, mm; arteries lie half as deep.
const BLUR_MM = 0.18;
// A vein of that radius, mm, is wide.
const WIDE_MM = 0.5;

@vertex
fn vessel_vertex(
    @builtin(vertex_index) corner: u32,
    @location(0) ends_mm: vec4f,
    // Radius, mm, shares at both ends, and 1 for an artery's.
    @location(1) look: vec4f,
) -> Vessel {
    let texel = paint.size_mm / paint.size_px;
    let reach = look.x + BLUR_MM + texel;
    let way = ends_mm.zw - ends_mm.xy;
    let along = way / max(length(way), 1e-6);
    let aside = vec2f(-along.y, along.x);
    let far = corner == 2u || corner == 4u || corner == 5u;
    let left = corner == 1u || corner == 3u || corner == 5u;
    let end = select(ends_mm.xy - reach * along, ends_mm.zw + reach * along, far);
    let at = end + select(-reach, reach, left) * aside;
    let ndc = at / (0.5 * paint.size_mm);
    return Vessel(vec4f(ndc.x, -ndc.y, 0.0, 1.0), at, ends_mm, look.x, look.yz, look.w);
}

@fragment
fn vessel_fragment(in: Vessel) -> @location(0) vec4f {
    let way = in.ends_mm.zw - in.ends_mm.xy;
    let offset = in.at_mm - in.ends_mm.xy;
    let t = clamp(dot(offset, way) / max(dot(way, way), 1e-9), 0.0, 1.0);
    let radius = in.radius_mm;
    // Of half a texel at least, and the fainter for it.
    let drawn = max(radius, 0.5 * paint.size_mm / paint.size_px);
    let blur_mm = select(BLUR_MM, 0.5 * BLUR_MM, in.is_artery > 0.5);
    let inside = 1.0 - smoothstep(0.25 * drawn, drawn + blur_mm, length(offset - t * way));
    let seen = mix(in.shares.x, in.shares.y, t) * inside * radius / drawn;
    if in.is_artery > 0.5 {
        return vec4f(0.0, seen, 0.0, 0.0);
    }
    return vec4f(seen, 0.0, seen * min(radius / WIDE_MM, 1.0), 0.0);
}
