//! Surface nets (Gibson 1998) of all groups at once.
//!
//! Every face between voxels of two groups is a quad, every corner of such a face a vertex, which
//! smoothing may move within half a voxel. Groups that meet share the quads between them.
//!
//! S. F. F. Gibson's nets have a vertex a cell of eight voxel centres whose labels differ, and a
//! quad a face between differing voxels. A corner of voxels is the middle of such a cell, so the
//! two descriptions are the same. With several labels a cell has still one vertex: all groups at it
//! share it, and neither gaps nor overlaps can arise, whatever moves the vertices later.
//!
//! The quads around a group are closed as the volume has a margin. They are a manifold only where
//! no group touches itself at an edge or a corner, which [`crate::clean::separate_touching`] sees
//! to.

use nalgebra::Point3;

use crate::number::{index, real};
use crate::volume::Padded;

/// No vertex.
///
/// The mark of a slot of `Sweep::planes` at whose corner no face has been met.
const NONE: u32 = u32::MAX;

/// Quads between groups.
///
/// `quads` and `sides` have the same length. The vertices of a quad are corners of one face of a
/// voxel until smoothing moves them.
#[derive(Clone, Debug, Default)]
pub struct Net {
    /// Places of vertices, voxel coordinates of the lattice without margin: whole numbers plus a
    /// half, -0.5 at the outer side of voxel 0.
    pub positions: Vec<Point3<f64>>,
    /// Corners of quads, counter-clockwise seen from the group that `sides` names second, in voxel
    /// coordinates.
    pub quads: Vec<[u32; 4]>,
    /// The groups behind and before each quad, never the same; 0 is background. The normal points
    /// from the first to the second.
    pub sides: Vec<[u8; 2]>,
}

/// Vertices of two neighbouring planes of corners, while a volume is swept.
struct Sweep<'a> {
    /// The volume that is swept along its third axis.
    volume: &'a Padded,
    /// What has been found so far.
    net: Net,
    /// Vertices at the corners below and above the slice.
    ///
    /// Slot `i + dims[0] * j` is the corner before voxel (i, j) in both axes.
    planes: [Vec<u32>; 2],
}

impl Sweep<'_> {
    /// The vertex at the corner (i, j) of plane `above` of slice z.
    ///
    /// It is made when the first quad needs it, so corners inside of a group get none.
    fn vertex(&mut self, i: usize, j: usize, z: usize, above: usize) -> u32 {
        let slot = &mut self.planes[above][i + self.volume.dims[0] * j];
        if *slot == NONE {
            *slot = index(self.net.positions.len());
            // Corner 0 is half a voxel before voxel 0, which is the margin.
            let place = [i, j, z + above].map(|c| real(c) - 1.5);
            self.net.positions.push(Point3::from(place));
        }
        *slot
    }

    /// Adds a quad whose corners are (i, j, plane), counter-clockwise seen from `sides[1]`.
    fn quad(&mut self, corners: [(usize, usize, usize); 4], z: usize, sides: [u8; 2]) {
        let quad = corners.map(|(i, j, above)| self.vertex(i, j, z, above));
        self.net.quads.push(quad);
        self.net.sides.push(sides);
    }

    /// Quads of the voxel (x, y, z) with those before it along each axis.
    ///
    /// All of x, y and z are at least 1: the voxel before must exist.
    fn voxel(&mut self, x: usize, y: usize, z: usize) {
        let at = self.volume.index(x, y, z);
        let here = self.volume.voxels[at];
        let [sx, sy, sz] = self.volume.strides();
        let before = |stride: usize| self.volume.voxels[at - stride];
        let [left, front, below] = [before(sx), before(sy), before(sz)];
        if left != here {
            self.quad(
                [(x, y, 0), (x, y + 1, 0), (x, y + 1, 1), (x, y, 1)],
                z,
                [left, here],
            );
        }
        if front != here {
            self.quad(
                [(x, y, 0), (x, y, 1), (x + 1, y, 1), (x + 1, y, 0)],
                z,
                [front, here],
            );
        }
        if below != here {
            self.quad(
                [(x, y, 0), (x + 1, y, 0), (x + 1, y + 1, 0), (x, y + 1, 0)],
                z,
                [below, here],
            );
        }
    }
}

/// The quads between all groups of `volume`.
///
/// One pass over the voxels on one core; besides the result it keeps two planes of corners. The
/// order of vertices and quads is that of the voxels.
#[must_use]
pub fn extract(volume: &Padded) -> Net {
    let slice = volume.dims[0] * volume.dims[1];
    let mut sweep = Sweep {
        volume,
        net: Net::default(),
        planes: [vec![NONE; slice], vec![NONE; slice]],
    };
    let [sx, sy, sz] = volume.strides();
    for z in 1..volume.dims[2] {
        for y in 1..volume.dims[1] {
            for x in 1..volume.dims[0] {
                let at = volume.index(x, y, z);
                let here = volume.voxels[at];
                let alike = [sx, sy, sz]
                    .iter()
                    .all(|stride| volume.voxels[at - stride] == here);
                if !alike {
                    sweep.voxel(x, y, z);
                }
            }
        }
        sweep.planes.swap(0, 1);
        sweep.planes[1].fill(NONE);
    }
    sweep.net
}
