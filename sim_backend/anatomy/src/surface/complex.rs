//! Triangles between groups: one set for all, of which each group's mesh is a part.
//!
//! From here on positions are in the world. [`crate::mesh::GroupMesh::of`] cuts one group out;
//! `balance`, `decimate` and the search for crossings work on all groups at once, since a move of a
//! common surface concerns both.

use nalgebra::Point3;
use rayon::prelude::*;

use super::nets::Net;
use crate::grid::Grid;

/// Triangles between groups, in the world.
///
/// `triangles` and `sides` have the same length. A group's surface is all triangles that have it on
/// either side, turned outwards. The union is not a manifold: along lines where three groups meet
/// an edge has three triangles.
#[derive(Clone, Debug, Default)]
pub struct Complex {
    /// Places of vertices in the scan's world (RAS), mm.
    pub positions: Vec<Point3<f64>>,
    /// Corners of triangles, counter-clockwise seen from the group that `sides` names second.
    pub triangles: Vec<[u32; 3]>,
    /// The groups behind and before each triangle; 0 is background. The normal points to the
    /// second. Marching cubes always have 0 second, see `Complex::is_apart`.
    pub sides: Vec<[u8; 2]>,
}

impl Complex {
    /// The quads of `net`, which lie on `grid`, each as two triangles along its shorter diagonal.
    ///
    /// The shorter diagonal, in mm, bends a folded quad less. It is chosen once: later moves may
    /// make the other one shorter.
    #[must_use]
    pub fn of_net(net: Net, grid: &Grid) -> Self {
        let positions: Vec<_> = net.positions.par_iter().map(|p| grid.world(p)).collect();
        let mut triangles = Vec::with_capacity(2 * net.quads.len());
        let mut sides = Vec::with_capacity(2 * net.quads.len());
        for (quad, side) in net.quads.into_iter().zip(net.sides) {
            let [a, b, c, d] = quad;
            let length =
                |a: u32, b: u32| (positions[a as usize] - positions[b as usize]).norm_squared();
            let pair = if length(a, c) <= length(b, d) {
                [[a, b, c], [a, c, d]]
            } else {
                [[b, c, d], [b, d, a]]
            };
            triangles.extend(pair);
            sides.extend([side; 2]);
        }
        let mut complex = Self {
            positions,
            triangles,
            sides,
        };
        if grid.is_mirrored() {
            complex.flip();
        }
        complex
    }

    /// The same, from voxel coordinates on `grid` to the world.
    ///
    /// For marching cubes, whose vertices are in voxel coordinates until they are smooth. Calling
    /// it twice would place twice.
    #[must_use]
    pub fn placed(mut self, grid: &Grid) -> Self {
        for position in &mut self.positions {
            *position = grid.world(position);
        }
        if grid.is_mirrored() {
            self.flip();
        }
        self
    }

    /// Turns every triangle to its other side, as a mirroring of its vertices did.
    pub(crate) fn flip(&mut self) {
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
    }

    /// Corners of a triangle.
    #[must_use]
    pub fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// Whether each group has triangles of its own, outward, as marching cubes make them: surfaces
    /// of neighbours are then near each other twice. Surface nets have triangles with the
    /// background before them too.
    ///
    /// True of an empty complex.
    pub(crate) fn is_apart(&self) -> bool {
        self.sides.iter().all(|sides| sides[1] == 0)
    }

    /// The volume of each group by its number, mm³; the background's is the negative of all
    /// others'.
    ///
    /// 32 numbers. Each triangle adds the signed volume of its tetrahedron with a fixed point to
    /// the group behind it and takes it from the one before it; on closed surfaces the fixed point
    /// cancels.
    #[must_use]
    pub fn volumes(&self) -> Vec<f64> {
        let mut volumes = vec![0.0; 32];
        // About a point nearby, for the digits' sake.
        let Some(about) = self.positions.first().copied() else {
            return volumes;
        };
        for (triangle, sides) in self.sides.iter().enumerate() {
            let [a, b, c] = self.corners(triangle).map(|p| p - about);
            let sixth = a.dot(&b.cross(&c)) / 6.0;
            volumes[usize::from(sides[0])] += sixth;
            volumes[usize::from(sides[1])] -= sixth;
        }
        volumes
    }
}
