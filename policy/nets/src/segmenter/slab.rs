//! Sums of scores over a part of a volume, and the way back from them to the volume's lattice.

use std::ops::Range;

use tch::{Device, Kind, TchError, Tensor};

use super::SegmentError;
use super::axis::{Axis, sample, whole};
use crate::dimension::{dimension, length};

/// The class of a voxel that is none of the model's.
pub const BACKGROUND: u8 = 255;

/// Sums over a strip of rows and as many slices as a window has.
///
/// It moves along z: a slice that no further window covers is taken out, and the others move up.
pub(super) struct Slab {
    /// `(classes, z, y, x)`.
    scores: Tensor,
    /// `(z, y, x)`.
    weights: Tensor,
    /// Its first slice.
    pub(super) z: usize,
    /// Its rows.
    pub(super) rows: Range<usize>,
}

impl Slab {
    pub(super) fn new(
        classes: usize,
        [x, y, z]: [&Axis; 3],
        rows: Range<usize>,
        like: &Tensor,
    ) -> Result<Self, TchError> {
        let shape = [
            dimension(classes),
            dimension(z.patch),
            dimension(rows.len()),
            dimension(x.padded),
        ];
        assert!(rows.end <= y.padded, "rows of the volume");
        let options = (Kind::Float, like.device());
        Ok(Self {
            scores: Tensor::f_zeros(shape, options)?,
            weights: Tensor::f_zeros(&shape[1..], options)?,
            z: 0,
            rows,
        })
    }

    /// Adds the scores `(classes, z, y, x)` of the window at `(x, y)`, whose first slice is the
    /// slab's.
    pub(super) fn add(
        &mut self,
        scores: &Tensor,
        weights: &Tensor,
        [x, y]: [usize; 2],
    ) -> Result<(), TchError> {
        let &[_, _, high, wide] = scores.size().as_slice() else {
            return Err(TchError::Shape("scores of four dimensions".to_owned()));
        };
        let first = y.max(self.rows.start);
        let count = dimension((y + length(high)).min(self.rows.end) - first);
        let [from, to, x] = [first - y, first - self.rows.start, x].map(dimension);
        let part = weights.f_narrow(1, from, count)?;
        let weighted = scores.f_narrow(2, from, count)?.f_mul(&part)?;
        let _ = self
            .scores
            .f_narrow(2, to, count)?
            .f_narrow(3, x, wide)?
            .f_add_(&weighted)?;
        let _ = self
            .weights
            .f_narrow(1, to, count)?
            .f_narrow(2, x, wide)?
            .f_add_(&part)?;
        Ok(())
    }

    /// Averages `(classes, y, x)` of slice `z`.
    pub(super) fn slice(&self, z: usize) -> Result<Tensor, SegmentError> {
        let at = dimension(z - self.z);
        let mean = self
            .scores
            .f_select(1, at)?
            .f_div(&self.weights.f_select(0, at)?)?;
        if !bool::try_from(mean.f_isfinite()?.f_all()?)? {
            return Err(SegmentError::Model(
                "gives numbers that are not finite".to_owned(),
            ));
        }
        Ok(mean)
    }

    /// Moves on so that the first slice is `z`.
    pub(super) fn advance(&mut self, z: usize) -> Result<(), TchError> {
        let by = dimension(z - self.z);
        for (tensor, dim) in [(&self.scores, 1), (&self.weights, 0)] {
            let depth = tensor.size()[length(dim)];
            for to in 0..depth {
                let mut slice = tensor.f_select(dim, to)?;
                if to + by < depth {
                    slice.f_copy_(&tensor.f_select(dim, to + by)?)?;
                } else {
                    let _ = slice.f_zero_()?;
                }
            }
        }
        self.z = z;
        Ok(())
    }
}

/// Slices of the volume between those that the network saw.
pub(super) struct Back<'a> {
    pub(super) axes: &'a [Axis; 3],
    /// Rows of the volume.
    pub(super) rows: Range<usize>,
    /// Whether a voxel without a positive score is background.
    pub(super) implied_background: bool,
    /// Slice of the volume that is next.
    pub(super) next: usize,
    /// Scores `(classes, rows, columns)` of the slice before, on the volume's lattice within its
    /// plane.
    pub(super) last: Option<Tensor>,
    pub(super) classes: &'a mut [u8],
}

impl Back<'_> {
    /// Takes the slice `z` of `slab`, and writes the volume's slices up to there.
    pub(super) fn take(&mut self, slab: &Slab, z: usize) -> Result<(), SegmentError> {
        let [x, y, along] = self.axes;
        if self.next == along.voxels || whole(along.place(self.next)) > z {
            return Ok(());
        }
        #[expect(clippy::cast_precision_loss, reason = "rows of a volume")]
        let first = slab.rows.start as f64;
        let rows: Vec<f64> = self.rows.clone().map(|row| y.place(row) - first).collect();
        let columns: Vec<f64> = (0..x.voxels).map(|column| x.place(column)).collect();
        let here = sample(&sample(&slab.slice(z)?, 1, &rows)?, 2, &columns)?;
        let last = self.last.take();
        #[expect(clippy::cast_precision_loss, reason = "slices of a volume")]
        let (z, before) = (z as f64, z as f64 - 1.0);
        while self.next < along.voxels && along.place(self.next) <= z {
            let share = along.place(self.next) - before;
            let scores = match &last {
                Some(last) if share < 1.0 => last.f_lerp(&here, share)?,
                _ => here.shallow_clone(),
            };
            self.write(&scores)?;
            self.next += 1;
        }
        self.last = Some(here);
        Ok(())
    }

    /// Writes the best classes of `scores` `(classes, rows, columns)`.
    fn write(&mut self, scores: &Tensor) -> Result<(), TchError> {
        let (best, mut classes) = scores.f_max_dim(0, false)?;
        if self.implied_background {
            classes = classes.f_masked_fill(&best.f_le(0.0)?, i64::from(BACKGROUND))?;
        }
        let [x, y, _] = self.axes;
        let start = (self.next * y.voxels + self.rows.start) * x.voxels;
        let plain = classes.f_to_kind(Kind::Uint8)?.f_to_device(Device::Cpu)?;
        let out = &mut self.classes[start..start + self.rows.len() * x.voxels];
        plain.f_contiguous()?.f_copy_data_u8(out, out.len())
    }
}
