//! How a flap lies before it has settled.

use super::bed::Bed;
use super::sheet::Sheet;

/// Slope of a sheet as it is laid down, at most.
const GENTLE: f64 = 0.15;

/// Lays a flat sheet down: every node to where it touches the ground, but nowhere steeper than a gentle slope, so that it
/// begins nearly unstretched and stands out over an organ's rim. Where there is no ground at all it lies level.
pub(super) fn lay(sheet: &mut Sheet, bed: &Bed) {
    let heights = sheet.positions.iter().map(|at| bed.height_m(at.x, at.y));
    let mut heights_m: Vec<f64> = heights.map(|height| height.unwrap_or(f64::MIN)).collect();
    if heights_m.iter().all(|height_m| *height_m <= f64::MIN) {
        heights_m.fill(0.0);
    }
    let [columns, rows] = sheet.nodes;
    let fall_m = sheet.spacing_m.map(|spacing_m| GENTLE * spacing_m);
    let mut ease = |here: usize, beside: usize, fall_m: f64| {
        heights_m[here] = heights_m[here].max(heights_m[beside] - fall_m);
    };
    for j in 0..rows {
        for i in 1..columns {
            ease(sheet.node(i, j), sheet.node(i - 1, j), fall_m[0]);
        }
        for i in (1..columns).rev() {
            ease(sheet.node(i - 1, j), sheet.node(i, j), fall_m[0]);
        }
    }
    for i in 0..columns {
        for j in 1..rows {
            ease(sheet.node(i, j), sheet.node(i, j - 1), fall_m[1]);
        }
        for j in (1..rows).rev() {
            ease(sheet.node(i, j - 1), sheet.node(i, j), fall_m[1]);
        }
    }
    for (position, height_m) in sheet.positions.iter_mut().zip(heights_m) {
        position.z = height_m + 0.5 * sheet.material.thickness_m;
    }
}
