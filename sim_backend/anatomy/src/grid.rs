//! Where the voxels of a scan lie.
//!
//! A lattice is an affine map from voxel indices to the scan's world. NIfTI's sform and DICOM's
//! image plane both become one; nothing behind the readers knows which file it was. Volumes store
//! voxel `(i, j, k)` at index `i + dims[0] * (j + dims[1] * k)`, whatever the axes are called in
//! the patient.
//!
//! [`Turn`] permutes and reverses axes without resampling. It is for networks that want a fixed
//! orientation; surfaces are made on the file's own lattice.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::number::real;

/// A lattice of voxels and its place in the world: right, anterior, superior (RAS) of the scan, mm.
///
/// World from voxel: `p = steps * (i, j, k) + origin`. The axes may be oblique and, of a tilted
/// gantry, not at right angles. Readers keep `steps` invertible, the spacings in 0.01 to 100 mm and
/// the sides in 1 to 4096; the public fields don't enforce it.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Voxels along the first, second and third axis of the file. The first runs fastest in memory.
    pub dims: [usize; 3],
    /// Columns are the steps in the world from a voxel to its neighbour along each axis, mm:
    /// direction cosines times spacing, the upper left 3 x 3 of NIfTI's sform.
    pub steps: Matrix3<f64>,
    /// Where the centre of voxel (0, 0, 0) is in the world, mm.
    pub origin: Vector3<f64>,
}

impl Grid {
    /// A lattice along the world's axes with `spacing` (mm), centred on the world's origin.
    #[must_use]
    pub fn centred(dims: [usize; 3], spacing: [f64; 3]) -> Self {
        let middle = Vector3::from_fn(|axis, _| -0.5 * spacing[axis] * (real(dims[axis]) - 1.0));
        Self {
            dims,
            steps: Matrix3::from_diagonal(&Vector3::from(spacing)),
            origin: middle,
        }
    }

    /// How many voxels there are.
    ///
    /// It is also the length of every buffer of voxels on this lattice. The product is not checked:
    /// readers bound it by 2^30.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.dims[0] * self.dims[1] * self.dims[2]
    }

    /// Whether there is no voxel.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Voxels of a slice across the third axis.
    #[must_use]
    pub const fn slice_len(&self) -> usize {
        self.dims[0] * self.dims[1]
    }

    /// The point with voxel coordinates `voxel` (whole numbers at centres) in the world, mm.
    #[must_use]
    pub fn world(&self, voxel: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.steps * voxel.coords + self.origin)
    }

    /// Voxel coordinates from the world; none if the lattice is flat.
    ///
    /// The linear part alone: take `origin` off a point before it is multiplied. Inverts 3 x 3 on
    /// each call, so callers keep it outside of their loops.
    #[must_use]
    pub fn voxel_from_world(&self) -> Option<Matrix3<f64>> {
        self.steps.try_inverse()
    }

    /// Distances between neighbours along the axes, mm.
    #[must_use]
    pub fn spacing(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.steps.column(axis).norm())
    }

    /// Volume of a voxel, mm³.
    ///
    /// It is that of the parallelepiped of the three steps, so right for sheared lattices too.
    #[must_use]
    pub fn voxel_mm3(&self) -> f64 {
        self.steps.determinant().abs()
    }

    /// Whether the axes of the file are a left-handed set in the world, so that what winds one way
    /// there winds the other here.
    ///
    /// A determinant below 0, as of the `LAS` volumes of many scanners. Triangles that were wound
    /// in voxel coordinates are then turned over (`Complex::flip`).
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.steps.determinant() < 0.0
    }

    /// The axes as letters: where each one of the file leads in the world, such as `LPS`.
    ///
    /// Each letter is the direction in which the index grows (nibabel's convention, the one of
    /// NIfTI). An axis is named by its largest component, so a lattice turned by about 45 degrees
    /// may have a letter twice.
    #[must_use]
    pub fn orientation(&self) -> String {
        let letters = [['R', 'L'], ['A', 'P'], ['S', 'I']];
        (0..3)
            .map(|axis| {
                let step = self.steps.column(axis);
                let along = step.iamax();
                letters[along][usize::from(step[along] < 0.0)]
            })
            .collect()
    }
}

/// A permutation and reversal of a lattice's axes, made by [`Grid::turn_to`]. It moves voxels and
/// mixes none, so that [`Turn::back`] undoes [`Turn::turned`] exactly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Sides of the lattice that it turns, in that lattice's order.
    dims: [usize; 3],
    /// Of each axis of the turned lattice, the lattice's own.
    from: [usize; 3],
    /// Whether it runs the other way.
    reversed: [bool; 3],
}

impl Grid {
    /// How the axes have to be permuted and reversed to lead in the directions nearest to `wanted`,
    /// such as `RAS`; none if those are not three directions.
    ///
    /// `wanted` is three letters of `R`/`L`, `A`/`P`, `S`/`I`, one of each pair. Of the six orders
    /// of axes the one with the largest sum of absolute cosines is taken, the identity first where
    /// several are equal; so two axes never get the same direction. An oblique lattice stays
    /// oblique: no voxel is interpolated.
    #[must_use]
    pub fn turn_to(&self, wanted: &str) -> Option<Turn> {
        let letters: Vec<char> = wanted.chars().collect();
        let [a, b, c] = <[char; 3]>::try_from(letters).ok()?.map(direction);
        let wanted = [a?, b?, c?];
        if wanted.iter().map(|(axis, _)| 1 << axis).sum::<usize>() != 0b111 {
            return None;
        }
        let cosine = |axis: usize, world: usize| self.steps[(world, axis)] / self.spacing()[axis];
        let along =
            |from: &[usize; 3]| -> f64 { (0..3).map(|k| cosine(from[k], wanted[k].0).abs()).sum() };
        let orders = [
            [0, 1, 2],
            [0, 2, 1],
            [1, 0, 2],
            [1, 2, 0],
            [2, 0, 1],
            [2, 1, 0],
        ];
        let from = orders.into_iter().reduce(|best, next| {
            // Of equals the first.
            if along(&next) > along(&best) + 1e-9 {
                next
            } else {
                best
            }
        })?;
        Some(Turn {
            dims: self.dims,
            from,
            reversed: [0, 1, 2].map(|k| (cosine(from[k], wanted[k].0) < 0.0) != wanted[k].1),
        })
    }
}

/// The axis of the world that a letter names, and whether it is the one against it.
fn direction(letter: char) -> Option<(usize, bool)> {
    let pairs = [['R', 'L'], ['A', 'P'], ['S', 'I']];
    let axis = pairs.iter().position(|pair| pair.contains(&letter))?;
    Some((axis, pairs[axis][1] == letter))
}

impl Turn {
    /// What belongs to the lattice's axes, by the turned ones.
    ///
    /// For sides and spacings. Signs are not applied, so it is not for directions.
    #[must_use]
    pub fn of<T: Copy>(&self, own: [T; 3]) -> [T; 3] {
        self.from.map(|axis| own[axis])
    }

    /// Of each voxel of the turned lattice in its order, the index in the lattice's own order.
    fn indices(&self) -> impl Iterator<Item = usize> + '_ {
        let strides = [1, self.dims[0], self.dims[0] * self.dims[1]];
        let [width, height, depth] = self.of(self.dims);
        let place = move |k: usize, at: usize| {
            let side = self.dims[self.from[k]];
            strides[self.from[k]] * if self.reversed[k] { side - 1 - at } else { at }
        };
        (0..depth).flat_map(move |z| {
            (0..height).flat_map(move |y| {
                let row = place(2, z) + place(1, y);
                (0..width).map(move |x| row + place(0, x))
            })
        })
    }

    /// `values` of the lattice's voxels in the order of the turned one.
    ///
    /// `values` has a value a voxel, the first axis fastest. A new buffer, O(n); panics if `values`
    /// is shorter than the lattice.
    #[must_use]
    pub fn turned<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.indices().map(|index| values[index]).collect()
    }

    /// `values` of the turned lattice's voxels in the order of the lattice's own.
    ///
    /// The inverse of [`Turn::turned`].
    #[must_use]
    pub fn back<T: Copy + Default>(&self, values: &[T]) -> Vec<T> {
        let mut own = vec![T::default(); values.len()];
        for (index, value) in self.indices().zip(values) {
            own[index] = *value;
        }
        own
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::Grid;

    #[test]
    fn orientation_reads_as_scanners_say_it() {
        let mut grid = Grid::centred([2, 2, 2], [1.0, 2.0, 3.0]);
        assert_eq!(grid.orientation(), "RAS");
        assert!(!grid.is_mirrored());
        grid.steps = Matrix3::from_diagonal(&Vector3::new(-1.0, -2.0, 3.0));
        assert_eq!(grid.orientation(), "LPS");
        grid.steps = Matrix3::new(0.0, 0.0, -3.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0);
        assert_eq!(grid.orientation(), "ASL");
        assert!(grid.is_mirrored());
    }

    #[test]
    fn turned_volumes_lead_where_they_should_and_come_back() {
        let mut grid = Grid::centred([2, 3, 4], [1.0, 2.0, 3.0]);
        // First axis to inferior, second to right, third to posterior.
        grid.steps = Matrix3::new(0.1, 2.0, 0.0, 0.0, 0.0, -3.0, -1.0, 0.1, 0.0);
        let turn = grid.turn_to("RAS").expect("three directions");
        assert_eq!(turn.of(grid.dims), [3, 4, 2]);
        let values: Vec<usize> = (0..24).collect();
        let turned = turn.turned(&values);
        // Its first voxel is the last along the first and third axis of the file.
        assert_eq!(turned[0], 1 + 2 * 3 * 3);
        assert_eq!(turned[1] - turned[0], 2);
        assert_eq!(turn.back(&turned), values);
        let own = Grid::centred([2, 3, 4], [1.0; 3]);
        let same = own.turn_to("RAS").expect("three directions");
        assert_eq!(same.turned(&values), values);
        for wrong in ["RAX", "RRS", "RA", "RLS"] {
            assert_eq!(grid.turn_to(wrong), None, "{wrong}");
        }
    }
}
