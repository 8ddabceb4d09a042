//! Points sorted into the cells of a coarse grid, each with its distance to the nearest point taken
//! so far.
//!
//! Rounding to nearest never reverses an order: if |a| <= |b| then the computed a² is at most the
//! computed b², and so for sums and differences. So the distance from a sample to the nearest place
//! of a bucket's bounding box, computed with the same operations as the distance to a point, is
//! never above the computed distance to any point in the box. A bucket whose farthest point is not
//! farther than that keeps all its distances, bit for bit.

use super::Point;
use super::error::PerceptionError;

/// Points that a bucket holds, about, when they lie on surfaces.
const POINTS_PER_BUCKET: usize = 128;

/// Buckets are not many more than this, about, however many points there are: each round looks at
/// every bucket.
const BUCKETS_MAX: usize = 1024;

/// Distances are computed for so many points at a time.
const LANES: usize = 8;

/// Coordinates are kept by axis, so that distances of eight points are computed side by side.
pub(super) struct Buckets {
    /// x, y and z of all points, bucket after bucket, m.
    axes: [Vec<f32>; 3],
    /// Squared distance of every point to the nearest taken one, m².
    nearest: Vec<f32>,
    /// Where the points were before the sorting.
    original: Vec<u32>,
    buckets: Vec<Bucket>,
}

/// A run of points that lie in one cell of the grid; at least one.
#[derive(Clone, Copy)]
struct Bucket {
    /// Its points are `start..end` of the sorted ones; `min` and `max` bound them, m, tighter than
    /// the cell does.
    start: usize,
    end: usize,
    min: Point,
    max: Point,
    /// Greatest of the points' distances.
    farthest: f32,
}

impl Buckets {
    /// A counting sort into the cells: O(points + cells).
    pub(super) fn new(points: &[Point]) -> Result<Self, PerceptionError> {
        let grid = Grid::around(points)?;
        let cells: Vec<u32> = points.iter().map(|point| grid.cell(point)).collect();
        let mut ends = vec![0_usize; grid.cells()];
        for &cell in &cells {
            ends[cell as usize] += 1;
        }
        let mut buckets = Vec::new();
        let mut start = 0;
        for place in &mut ends {
            let end = start + *place;
            if end > start {
                buckets.push(Bucket {
                    start,
                    end,
                    min: [f32::INFINITY; 3],
                    max: [f32::NEG_INFINITY; 3],
                    farthest: f32::INFINITY,
                });
            }
            *place = start;
            start = end;
        }
        // In order of the points, so that within a bucket the first of equals is the first of all.
        let mut sorted = Self {
            axes: core::array::from_fn(|_| vec![0.0; points.len()]),
            nearest: vec![f32::INFINITY; points.len()],
            original: vec![0; points.len()],
            buckets,
        };
        for ((point, &cell), index) in points.iter().zip(&cells).zip(0_u32..) {
            let place = &mut ends[cell as usize];
            for (axis, coordinate) in sorted.axes.iter_mut().zip(point) {
                axis[*place] = *coordinate;
            }
            sorted.original[*place] = index;
            *place += 1;
        }
        for bucket in &mut sorted.buckets {
            for (axis, places) in sorted.axes.iter().enumerate() {
                for &x in &places[bucket.start..bucket.end] {
                    bucket.min[axis] = bucket.min[axis].min(x);
                    bucket.max[axis] = bucket.max[axis].max(x);
                }
            }
        }
        Ok(sorted)
    }

    /// Takes `sample`: points nearer to it than to all before get that distance.
    pub(super) fn take(&mut self, sample: &Point) {
        let [x, y, z] = &self.axes;
        for bucket in &mut self.buckets {
            if bucket.least_distance(sample) >= bucket.farthest {
                continue;
            }
            let range = bucket.start..bucket.end;
            bucket.farthest = update(
                sample,
                [&x[range.clone()], &y[range.clone()], &z[range.clone()]],
                &mut self.nearest[range],
            );
        }
    }

    /// Index of the point farthest from the taken ones, the first of equals.
    pub(super) fn farthest(&self) -> usize {
        let greatest = self
            .buckets
            .iter()
            .fold(f32::NEG_INFINITY, |greatest, bucket| {
                greatest.max(bucket.farthest)
            });
        let first = self
            .buckets
            .iter()
            .filter(|bucket| bucket.farthest >= greatest)
            .filter_map(|bucket| {
                let inside = &self.nearest[bucket.start..bucket.end];
                let place = inside.iter().position(|&distance| distance >= greatest)?;
                Some(self.original[bucket.start + place])
            })
            .min();
        first.map_or(0, |index| index as usize)
    }
}

impl Bucket {
    /// Squared distance from `sample` to the box around the points, computed as distances to points
    /// are.
    fn least_distance(&self, sample: &Point) -> f32 {
        let [x, y, z] = core::array::from_fn(|axis| {
            sample[axis].clamp(self.min[axis], self.max[axis]) - sample[axis]
        });
        squared(x, y, z)
    }
}

/// The one order of operations in which every squared distance is computed, m².
fn squared(x: f32, y: f32, z: f32) -> f32 {
    (x * x + y * y) + z * z
}

/// Lowers `nearest` to the distances from `sample`, where these are less; the greatest that is
/// left.
fn update(sample: &Point, axes: [&[f32]; 3], nearest: &mut [f32]) -> f32 {
    let [xs, ys, zs] = axes.map(|axis| axis.as_chunks::<LANES>());
    let (whole, rest) = nearest.as_chunks_mut::<LANES>();
    let mut greatest = [f32::NEG_INFINITY; LANES];
    for (((nearest, x), y), z) in whole.iter_mut().zip(xs.0).zip(ys.0).zip(zs.0) {
        for lane in 0..LANES {
            let distance = squared(
                x[lane] - sample[0],
                y[lane] - sample[1],
                z[lane] - sample[2],
            );
            nearest[lane] = lesser(nearest[lane], distance);
            greatest[lane] = greater(greatest[lane], nearest[lane]);
        }
    }
    for (lane, nearest) in rest.iter_mut().enumerate() {
        let distance = squared(
            xs.1[lane] - sample[0],
            ys.1[lane] - sample[1],
            zs.1[lane] - sample[2],
        );
        *nearest = lesser(*nearest, distance);
        greatest[lane] = greater(greatest[lane], *nearest);
    }
    greatest.into_iter().fold(f32::NEG_INFINITY, greater)
}

// One instruction each, unlike f32's own, which think of NaN.
fn lesser(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// A grid over the points' bounding box.
struct Grid {
    min: Point,
    /// Cells a metre; 0 puts all points into one cell.
    per_m: f32,
    counts: [usize; 3],
}

impl Grid {
    /// A grid with about as many occupied cells as buckets are wanted, if the points lie on a
    /// surface, as those of a depth image do.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "counts of cells are small and positive; which cell a point lies in is only a matter of speed"
    )]
    fn around(points: &[Point]) -> Result<Self, PerceptionError> {
        if points.is_empty() {
            return Err(PerceptionError::NothingToChoose);
        }
        let (min, max) = corners(points)?;
        let buckets = (points.len() / POINTS_PER_BUCKET).clamp(1, BUCKETS_MAX) as f32;
        let extent: Point = core::array::from_fn(|axis| max[axis] - min[axis]);
        let surface = extent[0] * extent[1] + extent[1] * extent[2] + extent[2] * extent[0];
        let longest = extent.into_iter().fold(0.0, greater);
        // About as many cells as buckets for a sheet of points, and no more than that along a line.
        let side = greater((surface / buckets).sqrt(), longest / buckets);
        // Points at one place, or too far apart to measure: one cell.
        let per_m = if side.is_normal() && side.recip().is_normal() {
            side.recip()
        } else {
            0.0
        };
        let counts = extent.map(|extent| (extent * per_m) as usize + 1);
        Ok(Self { min, per_m, counts })
    }

    const fn cells(&self) -> usize {
        self.counts[0] * self.counts[1] * self.counts[2]
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "not negative, and cut to the grid"
    )]
    fn cell(&self, point: &Point) -> u32 {
        let [x, y, z] = core::array::from_fn(|axis| {
            let cell = ((point[axis] - self.min[axis]) * self.per_m) as usize;
            cell.min(self.counts[axis] - 1)
        });
        ((x * self.counts[1] + y) * self.counts[2] + z) as u32
    }
}

/// The lowest and the highest coordinates of `points`, m.
fn corners(points: &[Point]) -> Result<(Point, Point), PerceptionError> {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (index, point) in points.iter().enumerate() {
        for axis in 0..3 {
            if !point[axis].is_finite() {
                return Err(PerceptionError::NotFinite { index });
            }
            min[axis] = min[axis].min(point[axis]);
            max[axis] = max[axis].max(point[axis]);
        }
    }
    Ok((min, max))
}
