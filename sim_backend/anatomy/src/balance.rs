//! Volumes of all groups at once brought to what they should be, by moving the surfaces between
//! them along their normals.
//!
//! How far the surface between groups a and b moves is the difference of two potentials, p_a - p_b.
//! Of all moves that give each group its volume, to first order, these change the surfaces least;
//! the potentials solve a Laplace equation on the graph of groups, weighted by the areas of their
//! common surfaces.
//!
//! With `A_ab` the area between groups a and b, the change of a's volume is
//! `sum over b of A_ab (p_a - p_b)` to first order, which is the Laplacian of that graph applied to
//! `p`. The background has `p` = 0 and loses what all groups together gain. Smoothing and
//! decimation each end with it. Surfaces that cross are not looked for here: `hold` and the caller
//! prevent them.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use crate::surface::complex::Complex;

/// Groups with the background.
const GROUPS: usize = 32;

/// Times that volumes are measured and corrected.
const ROUNDS: u32 = 6;

/// Twice the area of a triangle along its normal.
///
/// It points to the group before the triangle, `sides[1]`.
fn area_normal(complex: &Complex, triangle: usize) -> Vector3<f64> {
    let [a, b, c] = complex.corners(triangle);
    (b - a).cross(&(c - a))
}

/// Potentials that add `wanted` (mm³ by group) to the volumes, mm.
///
/// None if the matrix is singular, as where a set of groups has no common surface with the
/// background. Entry 0 is 0.
fn potentials(complex: &Complex, wanted: &[f64]) -> Option<DVector<f64>> {
    let mut laplace = DMatrix::zeros(GROUPS, GROUPS);
    for (triangle, sides) in complex.sides.iter().enumerate() {
        let area = 0.5 * area_normal(complex, triangle).norm();
        let [a, b] = sides.map(usize::from);
        laplace[(a, a)] += area;
        laplace[(b, b)] += area;
        laplace[(a, b)] -= area;
        laplace[(b, a)] -= area;
    }
    let right = DVector::from_fn(
        GROUPS,
        |group, _| if group == 0 { 0.0 } else { wanted[group] },
    );
    // Groups that are not there, and the background, stay at 0.
    for group in 0..GROUPS {
        if group == 0 || laplace[(group, group)] <= 0.0 {
            laplace.row_mut(group).fill(0.0);
            laplace.column_mut(group).fill(0.0);
            laplace[(group, group)] = 1.0;
        }
    }
    laplace.lu().solve(&right)
}

/// Moves vertices so that each group has its volume of `targets` (mm³ by group number), none by
/// more than `most_mm`, and each to where `hold` lets it: of a vertex and the place it would go to
/// that gives the place where it goes.
///
/// Later rounds take what the first left by curvature and by what was held.
///
/// `targets` has 32 entries. A vertex moves by the mean of its triangles' moves, weighted by area,
/// and in each round by a sixth of `most_mm` at most; so a volume that is further off stays off,
/// and nothing reports that but the caller's measures.
pub(crate) fn balance(
    complex: &mut Complex,
    targets: &[f64],
    most_mm: f64,
    hold: impl Fn(usize, Point3<f64>) -> Point3<f64>,
) {
    for _ in 0..ROUNDS {
        let volumes = complex.volumes();
        let wanted: Vec<f64> = targets
            .iter()
            .zip(&volumes)
            .map(|(target, volume)| target - volume)
            .collect();
        let Some(potentials) = potentials(complex, &wanted) else {
            return;
        };
        let mut moves = vec![(Vector3::zeros(), 0.0); complex.positions.len()];
        for (triangle, sides) in complex.sides.iter().enumerate() {
            let normal = area_normal(complex, triangle);
            let by = potentials[usize::from(sides[0])] - potentials[usize::from(sides[1])];
            for v in complex.triangles[triangle] {
                let entry = &mut moves[v as usize];
                entry.0 += normal * by;
                entry.1 += normal.norm();
            }
        }
        for (v, (sum, weight)) in moves.into_iter().enumerate() {
            if weight > 0.0 {
                let by = (sum / weight).cap_magnitude(most_mm / f64::from(ROUNDS));
                complex.positions[v] = hold(v, complex.positions[v] + by);
            }
        }
    }
}
