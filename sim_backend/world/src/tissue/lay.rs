//! How a flap lies before it has settled.

use nalgebra::Vector3;

use super::bed::Bed;
use super::sheet::Sheet;

/// Slope of a sheet as it is laid down, at most; on a measured organ how much steeper it may get
/// from one cell to the next.
const GENTLE: f64 = 0.15;
/// Rise or fall of a cell that is laid along an organ, as a share of its length, at most.
const STEEP: f64 = 0.8;
/// Rounds in which the end of a cell is found: on a slope of 0.3 each leaves a tenth of the error.
/// The cell's length is right after each.
const ROUNDS: usize = 8;

/// Lays a flat sheet down on its ground.
pub(super) fn lay(sheet: &mut Sheet, bed: &Bed) {
    if bed.is_measured() {
        lay_along(sheet, bed);
    } else {
        lay_level(sheet, bed);
    }
}

/// Lays a sheet along an organ, beginning with its attached edge, every cell as long as at rest;
/// where the organ falls away, the sheet stands out over it.
fn lay_along(sheet: &mut Sheet, bed: &Bed) {
    let [columns, rows] = sheet.nodes;
    let way = |from: usize, to: usize| {
        let way = sheet.positions[to] - sheet.positions[from];
        way.normalize()
    };
    let along = way(sheet.node(0, 0), sheet.node(1, 0));
    let out = way(sheet.node(0, 0), sheet.node(0, 1));
    let [length_m, depth_m] = sheet.spacing_m;
    let middle = columns / 2;
    let start = sheet.node(middle, 0);
    let at = sheet.positions[start];
    sheet.positions[start].z = bed.height_m(at.x, at.y).unwrap_or(0.0);
    let mut put = |from: usize, to: usize, way: Vector3<f64>, fall: f64| {
        let step = step(bed, &sheet.positions[from], &way, fall);
        sheet.positions[to] = sheet.positions[from] + step;
        step.z / way.norm()
    };
    let node = |i: usize, j: usize| j * columns + i;
    for i in middle + 1..columns {
        put(node(i - 1, 0), node(i, 0), along * length_m, STEEP);
    }
    for i in (0..middle).rev() {
        put(node(i + 1, 0), node(i, 0), -along * length_m, STEEP);
    }
    for i in 0..columns {
        let mut fall = STEEP;
        for j in 1..rows {
            let rise = put(node(i, j - 1), node(i, j), out * depth_m, fall);
            fall = STEEP.min(GENTLE - rise);
        }
    }
    for position in &mut sheet.positions {
        position.z += 0.5 * sheet.material.thickness_m;
    }
}

/// From a point of the ground to another one, as far away as `way` is long and in its direction, no
/// lower than `fall` of that.
fn step(bed: &Bed, from: &Vector3<f64>, way: &Vector3<f64>, fall: f64) -> Vector3<f64> {
    let length_m = way.norm();
    let mut step = *way;
    for _ in 0..ROUNDS {
        let at = from + step;
        let rise_m = bed.height_m(at.x, at.y).map_or(f64::MIN, |z| z - from.z);
        let rise = (rise_m / length_m).clamp(-fall, STEEP);
        step = way * (1.0 - rise * rise).sqrt();
        step.z = rise * length_m;
    }
    step
}

/// Lays a flat sheet down: every node to where it touches the ground, but nowhere steeper than a
/// gentle slope, so that it begins nearly unstretched and stands out over an organ's rim. Where
/// there is no ground at all it lies level.
fn lay_level(sheet: &mut Sheet, bed: &Bed) {
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
