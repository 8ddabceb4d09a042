//! One axis of a volume: its voxels, those that the network sees, and the windows over these.

use tch::{Device, TchError, Tensor};

use crate::dimension::{dimension, length};

/// One axis. The middles of its first voxel and of the network's first one are at the same place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    /// Voxels of the volume.
    pub(super) voxels: usize,
    /// Voxels that the network sees of it.
    pub(super) seen: usize,
    /// Voxels that the network sees, with those around it if a window is larger.
    pub(super) padded: usize,
    /// Where the first of `seen` is in `padded`.
    pub(super) before: usize,
    /// Voxels of a window.
    pub(super) patch: usize,
    /// Where windows begin.
    pub(super) starts: Vec<usize>,
    /// The network's voxels from one of the volume to the next.
    step: f64,
}

#[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
const fn real(count: usize) -> f64 {
    count as f64
}

/// Towards zero.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "neither negative nor near 2^64"
)]
pub(super) const fn whole(value: f64) -> usize {
    value as usize
}

impl Axis {
    /// `voxels` of `spacing` mm, to be seen at `wanted` mm in windows of `patch` that overlap by
    /// `overlap`, laid as MONAI does.
    pub(super) fn new(
        voxels: usize,
        [spacing, wanted]: [f64; 2],
        patch: usize,
        overlap: f64,
    ) -> Self {
        let step = spacing / wanted;
        let seen = whole((real(voxels - 1) * step).round()) + 1;
        let padded = seen.max(patch);
        let interval = whole(real(patch) * (1.0 - overlap)).max(1);
        let mut starts: Vec<usize> = (0..)
            .map(|k| k * interval)
            .take_while(|start| start + patch < padded)
            .collect();
        starts.push(padded - patch);
        Self {
            voxels,
            seen,
            padded,
            before: (padded - seen) / 2,
            patch,
            starts,
            step,
        }
    }

    /// Where the middle of the volume's `voxel` is among the network's.
    pub(super) fn place(&self, voxel: usize) -> f64 {
        (real(voxel) * self.step).min(real(self.seen - 1)) + real(self.before)
    }

    /// Where the middles of the network's voxels are among the volume's.
    pub(super) fn sources(&self) -> Vec<f64> {
        let last = real(self.voxels - 1);
        (0..self.seen)
            .map(|voxel| (real(voxel) / self.step).min(last))
            .collect()
    }
}

/// `tensor` at `places` along `dim`, linear between neighbours.
pub(super) fn sample(tensor: &Tensor, dim: i64, places: &[f64]) -> Result<Tensor, TchError> {
    let last = tensor.size()[length(dim)] - 1;
    let mut each = places.iter().enumerate();
    let same = each.all(|(k, place)| (place - real(k)).abs() <= 0.0);
    if same && dimension(places.len()) == last + 1 {
        return Ok(tensor.shallow_clone());
    }
    let low: Vec<i64> = places
        .iter()
        .map(|place| dimension(whole(*place)).min(last))
        .collect();
    let high: Vec<i64> = low.iter().map(|index| (index + 1).min(last)).collect();
    #[expect(clippy::cast_possible_truncation, reason = "shares of a voxel")]
    let share: Vec<f32> = places.iter().map(|place| place.fract() as f32).collect();
    let mut shape = vec![1; tensor.dim()];
    shape[length(dim)] = dimension(places.len());
    let device: Device = tensor.device();
    let pick =
        |at: &[i64]| tensor.f_index_select(dim, &Tensor::f_from_slice(at)?.f_to_device(device)?);
    let share = Tensor::f_from_slice(&share)?
        .f_view(&shape[..])?
        .f_to_device(device)?;
    pick(&low)?.f_lerp_tensor(&pick(&high)?, &share)
}

/// Weights of the voxels of a window along an axis, before they are multiplied: a Gaussian whose
/// middle is 1.
pub(super) fn gaussian(patch: usize) -> Result<Tensor, TchError> {
    let deviation = 0.125 * real(patch);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "weights in single precision"
    )]
    let weights: Vec<f32> = (0..patch)
        .map(|k| {
            let x = real(k) - 0.5 * real(patch - 1);
            (-x * x / (2.0 * deviation * deviation)).exp() as f32
        })
        .collect();
    Tensor::f_from_slice(&weights)
}
