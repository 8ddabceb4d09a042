//! The upper side of a mesh as heights over a grid.
//!
//! A lattice about the origin, row by row: x changes fastest. Each triangle that faces up is
//! rasterized over the points below it, and each point keeps the highest: overhangs hide what is
//! under them.

use std::ops::Range;

use hal::{Mesh, Pose};
use nalgebra::{Point2, Point3};
use trocar_world::tissue::Ground;

/// Slope above which a step between two heights is no surface but an edge: another fold lies behind
/// it.
const SLOPE_MAX: f64 = 2.0;
/// Twice the area of a triangle, m², below which it is none from above.
const AREA_MIN: f64 = 1e-14;

/// Heights over a rectangle about the origin, NaN where there is nothing.
pub(super) struct Relief {
    /// The first point, x and y, m.
    low_m: [f64; 2],
    spacing_m: f64,
    /// How many along x and along y; odd, so that one is at the origin.
    points: [usize; 2],
    /// One for each point, m; NaN where there is no face that looks up.
    heights_m: Vec<f64>,
}

impl Relief {
    /// The highest faces of `mesh`, moved by `pose`, that look up, within `half_m` along x and y.
    pub(super) fn of(mesh: &Mesh, pose: &Pose, half_m: [f64; 2], spacing_m: f64) -> Self {
        let cells = half_m.map(|half_m| 2.0 * (half_m / spacing_m).floor());
        let points = cells.map(|cells| whole(cells) + 1);
        let mut relief = Self {
            low_m: cells.map(|cells| -0.5 * cells * spacing_m),
            spacing_m,
            points,
            heights_m: vec![f64::NAN; points[0] * points[1]],
        };
        let place = |p: &[f32; 3]| pose * Point3::from(p.map(f64::from));
        let corners: Vec<Point3<f64>> = mesh.positions.iter().map(place).collect();
        for triangle in mesh.indices.as_chunks::<3>().0 {
            relief.raise(triangle.map(|corner| corners[corner as usize]));
        }
        relief
    }

    /// The lines of the lattice across `axis` that meet the triangle `flat`.
    fn lines_over(&self, flat: &[Point2<f64>; 3], axis: usize) -> Range<usize> {
        let of = |choose: fn(f64, f64) -> f64| flat.iter().map(|p| p[axis]).reduce(choose);
        let index = |at: f64| (at - self.low_m[axis]) / self.spacing_m;
        let low = index(of(f64::min).unwrap_or(0.0)).ceil().max(0.0);
        let high = index(of(f64::max).unwrap_or(0.0)).floor();
        if high < low {
            0..0
        } else {
            whole(low)..(whole(high) + 1).min(self.points[axis])
        }
    }

    /// Takes in a face.
    fn raise(&mut self, face: [Point3<f64>; 3]) {
        let flat = face.map(|p| p.xy());
        let area = twice_area(&flat);
        if area < AREA_MIN {
            return;
        }
        let [columns, rows] = [0, 1].map(|axis| self.lines_over(&flat, axis));
        for row in rows {
            for column in columns.clone() {
                let at = self.place(column, row);
                // Shares of the corners: twice the area of what the other two make with the point.
                let shares = [[1, 2], [2, 0], [0, 1]]
                    .map(|[i, j]| twice_area(&[at, flat[i], flat[j]]) / area);
                if shares.iter().all(|share| *share >= -1e-9) {
                    let height_m = (0..3).map(|i| shares[i] * face[i].z).sum();
                    let highest = &mut self.heights_m[row * self.points[0] + column];
                    // The other one where this is NaN.
                    *highest = highest.max(height_m);
                }
            }
        }
    }

    fn place(&self, column: usize, row: usize) -> Point2<f64> {
        let along = |axis: usize, index: usize| self.low_m[axis] + real(index) * self.spacing_m;
        Point2::new(along(0, column), along(1, row))
    }

    /// Places with their heights, m.
    pub(super) fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        self.heights_m.iter().enumerate().map(|(index, height_m)| {
            let at = self.place(index % self.points[0], index / self.points[0]);
            (at.x, at.y, *height_m)
        })
    }

    /// The surface for physics, without what is too steep to be felt from above.
    pub(super) fn table(&self) -> Ground {
        let step_m = SLOPE_MAX * self.spacing_m;
        let [columns, rows] = self.points;
        let steep = |index: usize| {
            let here = self.heights_m[index];
            neighbours(index, [columns, rows])
                .map(|other| self.heights_m[other] - here)
                .any(|rise_m| rise_m.abs() > step_m)
        };
        let heights_m = (0..self.heights_m.len()).map(|index| {
            if steep(index) {
                f64::NAN
            } else {
                self.heights_m[index]
            }
        });
        Ground::table(self.low_m, self.spacing_m, self.points, heights_m.collect())
    }
}

/// The points beside, above and below the point `index` of a lattice.
fn neighbours(index: usize, [columns, rows]: [usize; 2]) -> impl Iterator<Item = usize> {
    let (column, row) = (index % columns, index / columns);
    let beside = [
        (column > 0).then(|| index - 1),
        (column + 1 < columns).then_some(index + 1),
        (row > 0).then(|| index - columns),
        (row + 1 < rows).then_some(index + columns),
    ];
    beside.into_iter().flatten()
}

/// Twice the area of a triangle, positive if it is counter-clockwise.
fn twice_area([a, b, c]: &[Point2<f64>; 3]) -> f64 {
    (b - a).perp(&(c - a))
}

/// A count of points.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a grid has few points, and casts saturate"
)]
pub(super) const fn whole(count: f64) -> usize {
    count as usize
}

#[expect(clippy::cast_precision_loss, reason = "a grid has few points")]
pub(super) const fn real(index: usize) -> f64 {
    index as f64
}
