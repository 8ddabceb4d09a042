//! Where the voxels of a scan lie.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::number::real;

/// A lattice of voxels and its place in the world: right, anterior, superior (RAS) of the scan, mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Voxels along the first, second and third axis of the file.
    pub dims: [usize; 3],
    /// Columns are the steps in the world from a voxel to its neighbour along each axis, mm.
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
    #[must_use]
    pub fn voxel_mm3(&self) -> f64 {
        self.steps.determinant().abs()
    }

    /// Whether the axes of the file are a left-handed set in the world, so that what winds one way there winds the other here.
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.steps.determinant() < 0.0
    }

    /// The axes as letters: where each one of the file leads in the world, such as `LPS`.
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
}
