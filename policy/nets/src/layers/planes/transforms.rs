//! Inputs to the values of a tile, the values to outputs, and kernels to the values that they
//! multiply.
//!
//! Whatever works on vectors is inlined into the function that may use the processor's; a closure
//! might not be.
//!
//! `Y = A^T ((G g G^T) * (B^T d B)) A` for a kernel `g` and inputs `d`, products of equal places
//! (Winograd 1980; Lavin and Gray 2016, eq. 8): `values` is `B^T` along one direction, `outputs`
//! `A^T`, `kernel_to_tile` `G g G^T`. The divisors of the interpolation are in `G`, which is
//! applied once, in double precision.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use pulp::Simd;

use super::tile::{INPUTS, OUTPUTS, Place, VALUES};
use super::{Epilogue, load, store};

/// Squares of the points of the interpolation.
const SQUARES: [f64; 2] = [0.5, 2.0];

/// What the transforms multiply with, in all lanes; `near` is the point at the root of a half,
/// `far` the one at the root of two.
#[derive(Clone, Copy)]
pub(super) struct Constants<S: Simd> {
    simd: S,
    near: S::f32s,
    minus_near: S::f32s,
    near_cubed: S::f32s,
    far: S::f32s,
    minus_far: S::f32s,
    far_cubed: S::f32s,
    half: S::f32s,
    minus_half: S::f32s,
    two: S::f32s,
    minus_two: S::f32s,
    /// The squares' sum, negative; their product is one.
    minus_sum: S::f32s,
}

impl<S: Simd> Constants<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        Self {
            simd,
            near: simd.splat_f32s(FRAC_1_SQRT_2),
            minus_near: simd.splat_f32s(-FRAC_1_SQRT_2),
            near_cubed: simd.splat_f32s(FRAC_1_SQRT_2 / 2.0),
            far: simd.splat_f32s(SQRT_2),
            minus_far: simd.splat_f32s(-SQRT_2),
            far_cubed: simd.splat_f32s(SQRT_2 * 2.0),
            half: simd.splat_f32s(0.5),
            minus_half: simd.splat_f32s(-0.5),
            two: simd.splat_f32s(2.0),
            minus_two: simd.splat_f32s(-2.0),
            minus_sum: simd.splat_f32s(-2.5),
        }
    }

    /// Six inputs along one direction to the values at the points 0, near, -near, far, -far and
    /// infinity.
    #[inline(always)]
    fn values(&self, d: [S::f32s; INPUTS]) -> [S::f32s; INPUTS] {
        let s = self.simd;
        let even = s.mul_add_f32s(self.minus_two, d[2], d[4]);
        let odd = s.mul_add_f32s(self.minus_two, d[1], d[3]);
        let far_even = s.mul_add_f32s(self.minus_half, d[2], d[4]);
        let far_odd = s.mul_add_f32s(self.minus_half, d[1], d[3]);
        [
            s.mul_add_f32s(self.minus_sum, d[2], s.add_f32s(d[0], d[4])),
            s.mul_add_f32s(self.near, odd, even),
            s.mul_add_f32s(self.minus_near, odd, even),
            s.mul_add_f32s(self.far, far_odd, far_even),
            s.mul_add_f32s(self.minus_far, far_odd, far_even),
            s.mul_add_f32s(self.minus_sum, d[3], s.add_f32s(d[1], d[5])),
        ]
    }

    /// Six values along one direction to four outputs.
    #[inline(always)]
    fn outputs(&self, m: [S::f32s; INPUTS]) -> [S::f32s; OUTPUTS] {
        let s = self.simd;
        let (near_sum, near_gap) = (s.add_f32s(m[1], m[2]), s.sub_f32s(m[1], m[2]));
        let (far_sum, far_gap) = (s.add_f32s(m[3], m[4]), s.sub_f32s(m[3], m[4]));
        let third = s.mul_add_f32s(self.far_cubed, far_gap, m[5]);
        [
            s.add_f32s(m[0], s.add_f32s(near_sum, far_sum)),
            s.mul_add_f32s(self.near, near_gap, s.mul_f32s(self.far, far_gap)),
            s.mul_add_f32s(self.half, near_sum, s.mul_f32s(self.two, far_sum)),
            s.mul_add_f32s(self.near_cubed, near_gap, third),
        ]
    }
}

/// A 3x3 kernel, row by row, to the values that a tile's are multiplied with.
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
pub(super) fn kernel_to_tile(kernel: &[f32; 9]) -> [f32; VALUES] {
    let [near, far] = SQUARES;
    let at = |point: f64, others: f64| [1.0, point, point * point].map(|power| power / others);
    let (near_others, far_others) = (2.0 * near * (near - far), 2.0 * far * (far - near));
    let rows: [[f64; 3]; INPUTS] = [
        [1.0 / (near * far), 0.0, 0.0],
        at(near.sqrt(), near_others),
        at(-near.sqrt(), near_others),
        at(far.sqrt(), far_others),
        at(-far.sqrt(), far_others),
        [0.0, 0.0, 1.0],
    ];
    std::array::from_fn(|value| {
        let (down, across) = (rows[value / INPUTS], rows[value % INPUTS]);
        let terms = kernel.iter().enumerate();
        terms
            .map(|(index, weight)| down[index / 3] * across[index % 3] * f64::from(*weight))
            .sum::<f64>() as f32
    })
}

/// The inputs about the tile at `place` to its values. `to` is where its first goes, and how far it
/// is to the next.
#[inline(always)]
pub(super) fn to_tile<S: Simd>(
    constants: &Constants<S>,
    x: &[f32],
    place: &Place,
    channels: usize,
    (to, between): (&mut [f32], usize),
) {
    let zero = constants.simd.splat_f32s(0.0);
    for channel in (0..channels).step_by(S::F32_LANES) {
        let mut rows = [[zero; INPUTS]; INPUTS];
        for (row, values) in rows.iter_mut().enumerate() {
            // One before the first row is greater than any.
            let y = (place.top + row).wrapping_sub(1);
            if y >= place.height {
                continue;
            }
            let mut seen = [zero; INPUTS];
            for (column, seen) in seen.iter_mut().enumerate() {
                let x_at = (place.left + column).wrapping_sub(1);
                if x_at < place.width {
                    let pixel = place.image + y * place.width + x_at;
                    *seen = load::<S>(x, pixel * channels + channel);
                }
            }
            *values = constants.values(seen);
        }
        for column in 0..INPUTS {
            let mut along = [zero; INPUTS];
            for (value, row) in along.iter_mut().zip(&rows) {
                *value = row[column];
            }
            let values = constants.values(along);
            for (row, value) in values.into_iter().enumerate() {
                store::<S>(to, (row * INPUTS + column) * between + channel, value);
            }
        }
    }
}

/// Products of a tile at `place`, of which `from` is the first and says how far it is to the next,
/// to outputs.
#[inline(always)]
pub(super) fn from_tile<S: Simd>(
    constants: &Constants<S>,
    (from, between): (&[f32], usize),
    place: &Place,
    ending: &Epilogue<'_>,
    out: &mut [f32],
) {
    let simd = constants.simd;
    let zero = simd.splat_f32s(0.0);
    let channels = ending.bias.len();
    let high = OUTPUTS.min(place.height - place.top);
    let wide = OUTPUTS.min(place.width - place.left);
    for channel in (0..channels).step_by(S::F32_LANES) {
        let mut columns = [[zero; OUTPUTS]; INPUTS];
        for (column, outputs) in columns.iter_mut().enumerate() {
            let mut along = [zero; INPUTS];
            for (row, product) in along.iter_mut().enumerate() {
                *product = load::<S>(from, (row * INPUTS + column) * between + channel);
            }
            *outputs = constants.outputs(along);
        }
        for row in 0..high {
            let mut along = [zero; INPUTS];
            for (value, column) in along.iter_mut().zip(&columns) {
                *value = column[row];
            }
            let outputs = constants.outputs(along);
            for (column, output) in outputs.into_iter().enumerate().take(wide) {
                let pixel = place.image + (place.top + row) * place.width + place.left + column;
                ending.write(simd, output, out, pixel * channels + channel, channel);
            }
        }
    }
}
