//! The faces of a group's voxels, in voxel coordinates of the padded volume.
//!
//! A face is the unit square between a voxel of the group and one that is not of it. Its middle is
//! half a voxel from both centres. The margin of the padded volume makes sure that every voxel of a
//! group has one before it.

use nalgebra::Point3;

use crate::number::{floor_to, real};
use crate::volume::Padded;

/// Whether a voxel and the one before it along `axis` differ in being of `group`.
///
/// `at` must have a voxel before it along `axis`, so x, y and z are at least 1.
fn is_face(volume: &Padded, group: u8, at: usize, axis: usize) -> bool {
    let before = at - volume.strides()[axis];
    (volume.voxels[at] == group) != (volume.voxels[before] == group)
}

/// Middles of the faces around `group`, evenly thinned to at most `most`.
///
/// Thinned by halves as they come, so the memory is bounded, and the same ones are left for the
/// same volume.
pub(super) fn face_middles(volume: &Padded, group: u8, most: usize) -> Vec<Point3<f64>> {
    let mut middles = Vec::new();
    let mut thinning = 1;
    let mut count = 0_usize;
    for z in 1..volume.dims[2] {
        for y in 1..volume.dims[1] {
            for x in 1..volume.dims[0] {
                let at = volume.index(x, y, z);
                for axis in (0..3).filter(|axis| is_face(volume, group, at, *axis)) {
                    if count.is_multiple_of(thinning) {
                        let mut middle = [x, y, z].map(real);
                        middle[axis] -= 0.5;
                        middles.push(Point3::from(middle));
                    }
                    count += 1;
                }
                if middles.len() > most {
                    middles = middles.into_iter().step_by(2).collect();
                    thinning *= 2;
                }
            }
        }
    }
    middles
}

/// Squared distance of `p` from the face before the voxel `voxel` along `axis`.
fn face_distance_squared(p: &Point3<f64>, voxel: [usize; 3], axis: usize) -> f64 {
    (0..3)
        .map(|k| {
            let from_middle = p[k] - real(voxel[k]);
            let outside = if k == axis {
                from_middle + 0.5
            } else {
                (from_middle.abs() - 0.5).max(0.0)
            };
            outside * outside
        })
        .sum()
}

/// The distance of `p` from the nearest face around `group`, voxels.
///
/// A search in a cube of voxels about `p` that doubles until the nearest face found is nearer than
/// what it has not seen. Cheap near the surface, which is where mesh points are; O(reach^3) far
/// from it. Infinite if the group has no faces.
pub(super) fn distance_to_boundary(volume: &Padded, group: u8, p: &Point3<f64>) -> f64 {
    let mut reach = 1;
    loop {
        let range = |k: usize| {
            let middle = floor_to(p[k].round(), volume.dims[k] - 1);
            middle.saturating_sub(reach).max(1)..=(middle + reach).min(volume.dims[k] - 1)
        };
        let mut best = f64::INFINITY;
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let at = volume.index(x, y, z);
                    for axis in (0..3).filter(|axis| is_face(volume, group, at, *axis)) {
                        best = best.min(face_distance_squared(p, [x, y, z], axis));
                    }
                }
            }
        }
        // Faces that were not looked at are farther than this.
        let seen = real(reach) - 0.5;
        let whole = reach >= volume.dims.into_iter().max().unwrap_or(0);
        if best.sqrt() <= seen || whole {
            return best.sqrt();
        }
        reach *= 2;
    }
}
