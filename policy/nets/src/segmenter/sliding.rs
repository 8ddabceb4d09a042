//! A volume classified window by window, with sums over a slab of it at a time.
//!
//! Scores of overlapping windows are averaged, brought back to the volume's lattice, linear between
//! neighbours, and the class with the highest wins. The sums are a number a class and voxel, so
//! only a slab of them is kept: as many slices as a window has, and of those a strip of rows if
//! that is too much. Windows at the edge of two strips are computed for both; the result is the
//! same to the bit.

use std::ops::Range;

use tch::{Kind, TchError, Tensor};

use super::axis::{Axis, gaussian, sample, whole};
use super::settings::Weighting;
use super::slab::{BACKGROUND, Back, Slab};
use super::{SegmentError, Segmenter, VOXELS_MAX};
use crate::dimension::dimension;
use hal::count::count_u32;

/// Copies of a slice of scores that are in memory at a time while it is brought back to the
/// volume's lattice.
const PLANES: usize = 6;

/// A CT volume whose axes lead where the model wants them.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    /// Voxels along x, y and z.
    pub dims: [usize; 3],
    /// Voxel size, mm.
    pub spacing_mm: [f64; 3],
    /// Values, HU, x fastest.
    pub values: &'a [f32],
}

/// Takes a slice of a slab.
type TakeSlice<'a> = dyn FnMut(&Slab, usize) -> Result<(), SegmentError> + 'a;

impl Segmenter {
    /// The class of each voxel of `image`, x fastest: an index into the settings' classes, or
    /// [`BACKGROUND`].
    ///
    /// `memory_bytes` bounds the sums, not what the network itself needs for a window. After each
    /// window `done` gets the number of windows so far and of all.
    ///
    /// # Errors
    /// [`SegmentError`].
    ///
    /// # Panics
    /// If the image has another number of values than voxels, or none.
    pub fn classify(
        &self,
        image: &Image<'_>,
        memory_bytes: u64,
        done: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<u8>, SegmentError> {
        let voxels = image.dims.iter().product::<usize>();
        assert!(
            voxels > 0 && image.values.len() == voxels,
            "a value a voxel"
        );
        let axes = self.axes(image);
        let sides = axes.iter().map(|axis| f64::from(count_u32(axis.padded)));
        let seen: f64 = sides.product();
        if seen > VOXELS_MAX {
            return Err(SegmentError::Large { voxels: seen });
        }
        let strips = self.strips(&axes, memory_bytes)?;
        let mut classes = vec![BACKGROUND; voxels];
        tch::no_grad(|| {
            let seen = self.seen(image, &axes)?;
            let weights = self.weights()?;
            let all = strips.iter().map(|strip| self.windows(&axes, strip)).sum();
            let mut count = 0;
            for strip in strips {
                let mut tell = || {
                    count += 1;
                    done(count, all);
                };
                let rows = Self::rows_for(&axes[1], &strip);
                let mut back = Back {
                    axes: &axes,
                    rows: strip,
                    implied_background: !self.settings.classes.contains(&0),
                    next: 0,
                    last: None,
                    classes: &mut classes,
                };
                let mut take = |slab: &Slab, z| back.take(slab, z);
                self.strip(&axes, rows, (&seen, &weights), (&mut take, &mut tell))?;
            }
            Ok(classes)
        })
    }

    /// Averaged scores `(classes, z, y, x)` of what the network sees of `image`.
    #[cfg(test)]
    pub(super) fn averages(&self, image: &Image<'_>) -> Result<Tensor, SegmentError> {
        let axes = self.axes(image);
        let rows = axes[1].before..axes[1].before + axes[1].seen;
        let mut slices = Vec::new();
        let mut take = |slab: &Slab, z| {
            slices.push(slab.slice(z)?);
            Ok(())
        };
        tch::no_grad(|| {
            let (seen, weights) = (self.seen(image, &axes)?, self.weights()?);
            self.strip(&axes, rows, (&seen, &weights), (&mut take, &mut || ()))
        })?;
        let [x, _, z] = axes.map(|axis| [axis.before, axis.seen].map(dimension));
        let all = Tensor::f_stack(&slices, 1)?;
        Ok(all.f_narrow(1, z[0], z[1])?.f_narrow(3, x[0], x[1])?)
    }

    /// x, y and z of `image` by the settings' spacing, window and overlap.
    fn axes(&self, image: &Image<'_>) -> [Axis; 3] {
        [0, 1, 2].map(|axis| {
            let spacing = [image.spacing_mm[axis], self.settings.spacing_mm[axis]];
            let patch = self.settings.patch[axis];
            Axis::new(image.dims[axis], spacing, patch, self.settings.overlap)
        })
    }

    /// Rows of the network's for the volume's `rows`.
    fn rows_for(y: &Axis, rows: &Range<usize>) -> Range<usize> {
        whole(y.place(rows.start))..whole(y.place(rows.end - 1).ceil()) + 1
    }

    /// Where along y windows for `rows` begin.
    fn beginnings<'a>(y: &'a Axis, rows: &'a Range<usize>) -> impl Iterator<Item = usize> + 'a {
        let touches = |start: &usize| *start < rows.end && start + y.patch > rows.start;
        y.starts.iter().copied().filter(touches)
    }

    /// How many windows a strip takes.
    fn windows(&self, [x, y, z]: &[Axis; 3], strip: &Range<usize>) -> usize {
        let rows = Self::rows_for(y, strip);
        Self::beginnings(y, &rows).count() * x.starts.len() * z.starts.len()
    }

    /// The volume's rows in as few strips as the memory allows.
    #[expect(clippy::cast_precision_loss, reason = "bytes for a message")]
    fn strips(
        &self,
        [x, y, z]: &[Axis; 3],
        memory_bytes: u64,
    ) -> Result<Vec<Range<usize>>, SegmentError> {
        let classes = self.settings.classes.len();
        let needed = |rows: &Range<usize>| {
            let slab = z.patch * Self::rows_for(y, rows).len() * x.padded;
            (4 * (classes * (slab + PLANES * rows.len() * x.voxels) + slab)) as u64
        };
        for count in 1..=y.voxels {
            let edge = |strip: usize| strip * y.voxels / count;
            let strips: Vec<Range<usize>> = (0..count)
                .map(|strip| edge(strip)..edge(strip + 1))
                .collect();
            if strips.iter().all(|rows| needed(rows) <= memory_bytes) {
                return Ok(strips);
            }
        }
        Err(SegmentError::Memory {
            classes,
            needed_gb: needed(&(0..1)) as f64 * 1e-9,
            allowed_gb: memory_bytes as f64 * 1e-9,
        })
    }

    /// What the network sees of `image`: `(z, y, x)`, on the CPU.
    fn seen(&self, image: &Image<'_>, axes: &[Axis; 3]) -> Result<Tensor, TchError> {
        let [low, high] = self.settings.window_hu;
        let [least, most] = self.settings.range;
        let [wide, high_y, deep] = image.dims.map(dimension);
        let mut seen = Tensor::f_from_slice(image.values)?.f_view([deep, high_y, wide])?;
        let _ = seen
            .f_sub_scalar_(low)?
            .f_mul_scalar_((most - least) / (high - low))?;
        let _ = seen.f_add_scalar_(least)?.f_clamp_(least, most)?;
        for (dim, axis) in [(0, &axes[2]), (1, &axes[1]), (2, &axes[0])] {
            seen = sample(&seen, dim, &axis.sources())?;
        }
        // The last dimension comes first.
        let padding = axes
            .iter()
            .flat_map(|axis| [axis.before, axis.padded - axis.seen - axis.before]);
        let padding: Vec<i64> = padding.map(dimension).collect();
        if padding.iter().all(|by| *by == 0) {
            return Ok(seen);
        }
        seen.f_constant_pad_nd(&padding[..])
    }

    /// Weights `(z, y, x)` of a window, on the device.
    fn weights(&self) -> Result<Tensor, TchError> {
        let [x, y, z] = self.settings.patch;
        let weights = match self.settings.weighting {
            Weighting::Constant => {
                Tensor::f_ones([z, y, x].map(dimension), (Kind::Float, tch::Device::Cpu))?
            }
            Weighting::Gaussian => {
                let along = |patch, shape: [i64; 3]| gaussian(patch)?.f_view(shape);
                let plane = along(y, [1, -1, 1])?.f_mul(&along(x, [1, 1, -1])?)?;
                let all = along(z, [-1, 1, 1])?.f_mul(&plane)?;
                // MONAI's floor, without which corners would divide by nearly nothing.
                let least = all.f_min()?.f_double_value(&[])?.max(1e-3);
                all.f_clamp_min(least)?
            }
        };
        weights.f_to_device(self.device)
    }

    /// Gives `take` each slice of the network's `rows` when it is complete, and calls `tell` after
    /// each window.
    fn strip(
        &self,
        [x, y, z]: &[Axis; 3],
        rows: Range<usize>,
        (seen, weights): (&Tensor, &Tensor),
        (take, tell): (&mut TakeSlice<'_>, &mut dyn FnMut()),
    ) -> Result<(), SegmentError> {
        let mut slab = Slab::new(
            self.settings.classes.len(),
            [x, y, z],
            rows.clone(),
            weights,
        )?;
        for &start in &z.starts {
            for slice in slab.z..start {
                take(&slab, slice)?;
            }
            slab.advance(start)?;
            let slices = seen.f_narrow(0, dimension(start), dimension(z.patch))?;
            for at_y in Self::beginnings(y, &rows) {
                let lines = slices.f_narrow(1, dimension(at_y), dimension(y.patch))?;
                for &at_x in &x.starts {
                    let window = lines.f_narrow(2, dimension(at_x), dimension(x.patch))?;
                    let scores = self.scores(&window.f_permute([2, 1, 0])?)?;
                    slab.add(&scores.f_permute([0, 3, 2, 1])?, weights, [at_x, at_y])?;
                    tell();
                }
            }
        }
        for slice in slab.z..z.padded {
            take(&slab, slice)?;
        }
        Ok(())
    }
}
