//! How high the neighbours of an organ may stand where it is worked on.

use hal::{Mesh, Pose};
use nalgebra::Point2;

use super::relief::{Relief, real, whole};

/// Radius of the place of work, m; height up to which neighbours stand there, m, and how much
/// higher for each metre beyond: gas and the assistant hold away what is higher, and what a camera
/// beside would have in its way.
const WORK_M: f64 = 0.040;
const LEVEL_M: f64 = -0.004;
const RISE: f64 = 0.4;
/// How far below the organ's surface they stay at work, m, and the slope at which they rise from
/// there.
const UNDER_M: f64 = 0.010;
const STEEP: f64 = 1.6;
/// Distance of the points of its table, m, how many there are along a side, and half the side, m.
const SPACING_M: f64 = 0.004;
const SIDE: usize = 101;
const HALF_M: f64 = 0.2;
/// How often each height becomes the mean of those around it.
const SMOOTHED: usize = 4;

/// A height for each place of the scene, continuous: a step would tear what crosses it.
pub(super) struct Ceiling {
    /// [`SIDE`] squared, row by row from the corner with the lowest x and y, m; between them it is
    /// bilinear.
    heights_m: Vec<f64>,
}

impl Ceiling {
    /// The one over `organ` (scene frame), which is worked on about the origin.
    pub(super) fn over(organ: &Mesh) -> Self {
        let relief = Relief::of(organ, &Pose::identity(), [WORK_M; 2], SPACING_M);
        let at_work = relief.points().filter(|(x, y, _)| x.hypot(*y) < WORK_M);
        // Where there is nothing of the organ its height is NaN, which is not low.
        let low: Vec<(Point2<f64>, f64)> = at_work
            .map(|(x, y, height_m)| (Point2::new(x, y), height_m - UNDER_M))
            .filter(|(_, height_m)| *height_m < LEVEL_M)
            .collect();
        let height_m = |index: usize| {
            let at = place(index);
            let beyond_m = (at.coords.norm() - WORK_M).max(0.0);
            let rising = low
                .iter()
                .map(|(from, height_m)| height_m + STEEP * (at - from).norm());
            rising.fold(LEVEL_M + RISE * beyond_m, f64::min)
        };
        let heights_m: Vec<f64> = (0..SIDE * SIDE).map(height_m).collect();
        Self {
            heights_m: (0..SMOOTHED).fold(heights_m, |heights_m, _| smoothed(&heights_m)),
        }
    }

    /// Its height at (`x`, `y`), m; beyond the table that of its edge.
    pub(super) fn height_m(&self, x: f64, y: f64) -> f64 {
        let split = |along_m: f64| {
            let at = ((along_m + HALF_M) / SPACING_M).clamp(0.0, real(SIDE - 1));
            let cell = whole(at).min(SIDE - 2);
            (cell, at - real(cell))
        };
        let ((column, right), (row, up)) = (split(x), split(y));
        let between = |row: usize| {
            let left = row * SIDE + column;
            let [from, to] = [left, left + 1].map(|index| self.heights_m[index]);
            from + right * (to - from)
        };
        let (lower, upper) = (between(row), between(row + 1));
        lower + up * (upper - lower)
    }

    /// How much it rises along x and along y at (`x`, `y`).
    pub(super) fn slope(&self, x: f64, y: f64) -> [f64; 2] {
        let rise_m =
            |dx: f64, dy: f64| self.height_m(x + dx, y + dy) - self.height_m(x - dx, y - dy);
        let rises_m = [rise_m(SPACING_M, 0.0), rise_m(0.0, SPACING_M)];
        rises_m.map(|rise_m| rise_m / (2.0 * SPACING_M))
    }
}

/// Where a point of the table is.
fn place(index: usize) -> Point2<f64> {
    let along = |index: usize| SPACING_M * real(index) - HALF_M;
    Point2::new(along(index % SIDE), along(index / SIDE))
}

/// Each height of the table as the mean of it and the eight around it.
fn smoothed(heights_m: &[f64]) -> Vec<f64> {
    let near = |at: usize| [at.saturating_sub(1), at, (at + 1).min(SIDE - 1)];
    let mean = |index: usize| {
        let columns = near(index % SIDE);
        let of_row = |row: usize| columns.map(|column| heights_m[row * SIDE + column]);
        let around = near(index / SIDE).map(of_row);
        around.iter().flatten().sum::<f64>() / 9.0
    };
    (0..heights_m.len()).map(mean).collect()
}
