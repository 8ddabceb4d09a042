//! Noise over space that depends on the place and a seed alone.

use hal::random::SplitMix64;
use nalgebra::{Matrix3, Point3, Vector3};

/// A number from 0 to 1 of a corner of the integer lattice.
fn lattice(corner: [i64; 3], seed: u64) -> f64 {
    let mixed = |hash: u64, at: i64| SplitMix64::new(hash ^ at.cast_unsigned()).next_u64();
    SplitMix64::new(corner.into_iter().fold(seed, mixed)).unit()
}

/// The cell of the lattice that `p` lies in, and where in it.
#[expect(
    clippy::cast_possible_truncation,
    reason = "places in a body, and casts saturate"
)]
fn cell(p: &Point3<f64>) -> ([i64; 3], Vector3<f64>) {
    let low = p.coords.map(f64::floor);
    ([low.x as i64, low.y as i64, low.z as i64], p.coords - low)
}

/// Rotation of the lattice's axes away from the body's, along which charts lie.
const ROTATION: Matrix3<f64> = Matrix3::new(
    2.0 / 3.0,
    -2.0 / 3.0,
    1.0 / 3.0, //
    1.0 / 3.0,
    2.0 / 3.0,
    2.0 / 3.0, //
    -2.0 / 3.0,
    -1.0 / 3.0,
    2.0 / 3.0,
);

/// Gradient noise (K. Perlin, "Improving noise", 2002) from -1 to 1, whose cells have sides of 1.
/// The lattice is turned by `ROTATION` first; gradients are even in a cube, not on a sphere.
pub(super) fn noise(p: &Point3<f64>, seed: u64) -> f64 {
    let (low, within) = cell(&(ROTATION * p));
    let eased = within.map(|t| t * t * t * (t * (6.0 * t - 15.0) + 10.0));
    let mut sum = 0.0;
    for corner in 0..8_i64 {
        let step = [corner & 1, corner >> 1 & 1, corner >> 2];
        let weight: f64 = (0..3)
            .map(|axis| {
                if step[axis] == 1 {
                    eased[axis]
                } else {
                    1.0 - eased[axis]
                }
            })
            .product();
        let at = [0, 1, 2].map(|axis| low[axis] + step[axis]);
        let gradient =
            Vector3::from([0, 1, 2].map(|axis| 2.0 * lattice(at, seed + 7919 * axis) - 1.0));
        sum += weight * gradient.dot(&(within - Vector3::from(step.map(small))));
    }
    // It stays within 0.7 nearly everywhere.
    (1.4 * sum).clamp(-1.0, 1.0)
}

/// Domain warping: `p` moved by up to `far` in each direction by noise.
pub(super) fn domain_warped(p: &Point3<f64>, far: f64, seed: u64) -> Point3<f64> {
    p + Vector3::from([0, 1, 2].map(|axis| far * noise(&(p * 0.7), seed + axis)))
}

/// Fractal noise: four octaves, each half as strong as the one before, from -1 to 1.
pub(super) fn fractal(p: &Point3<f64>, seed: u64) -> f64 {
    let octave = |(octave, seed): (i32, u64)| {
        let scale = 2.0_f64.powi(octave);
        noise(&(p * scale), seed) / scale
    };
    (0..4)
        .zip((0..).map(|step| seed + 1000 * step))
        .map(octave)
        .sum::<f64>()
        / 1.875
}

/// Worley noise (S. Worley, "A cellular texture basis function", 1996): distances to the nearest of
/// scattered points, one a cell of the lattice, and to the second one (F1, F2).
pub(super) fn worley(p: &Point3<f64>, seed: u64) -> (f64, f64) {
    let (low, within) = cell(&(ROTATION * p));
    let (mut near, mut second) = (f64::INFINITY, f64::INFINITY);
    for index in 0..27_i64 {
        let step = [index % 3 - 1, index / 3 % 3 - 1, index / 9 - 1];
        let corner = [0, 1, 2].map(|axis| low[axis] + step[axis]);
        let scattered = Vector3::from([0, 1, 2].map(|axis| lattice(corner, seed + 7919 * axis)));
        let distance = (Vector3::from(step.map(small)) + scattered - within).norm();
        if distance < near {
            (near, second) = (distance, near);
        } else {
            second = second.min(distance);
        }
    }
    (near, second)
}

/// Smoothstep from 0 at 0 to 1 at `to`.
pub(super) fn smoothstep(at: f64, to: f64) -> f64 {
    let share = (at / to).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

/// A step of the lattice as a number.
#[expect(clippy::cast_precision_loss, reason = "-1, 0 or 1")]
const fn small(step: i64) -> f64 {
    step as f64
}
