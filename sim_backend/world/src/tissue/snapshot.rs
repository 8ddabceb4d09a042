//! The shape of a flap at one instant, small and of fixed size, for the renderer in another thread.

use nalgebra::Vector3;

use super::flap::Tissue;

/// Most nodes that a drawn flap has.
pub const NODES_MAX: usize = 208;

/// The nodes and the mark of a flap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlapSnapshot {
    /// Places of the nodes in their order, scene frame, m; those past the flap's own number are
    /// zero.
    nodes_m: [[f32; 3]; NODES_MAX],
    /// The mark in the material, m.
    mark_m: [f64; 2],
}

impl FlapSnapshot {
    /// `tissue` as it is now. Of a flap with more than [`NODES_MAX`] nodes the last ones are
    /// missing.
    #[must_use]
    pub fn of(tissue: &Tissue) -> Self {
        let mut nodes_m = [[0.0; 3]; NODES_MAX];
        for (node_m, at) in nodes_m.iter_mut().zip(tissue.sheet().positions()) {
            #[expect(clippy::cast_possible_truncation, reason = "drawn in single precision")]
            let single = at.data.0[0].map(|x| x as f32);
            *node_m = single;
        }
        Self {
            nodes_m,
            mark_m: tissue.mark_m(),
        }
    }

    /// A flap with these nodes, scene frame, m, and its mark at `mark_m` in the material.
    #[must_use]
    pub const fn from_parts(nodes_m: [[f32; 3]; NODES_MAX], mark_m: [f64; 2]) -> Self {
        Self { nodes_m, mark_m }
    }

    /// All nodes as they are stored, scene frame, m; those past the flap's own number are zero.
    #[must_use]
    pub const fn nodes_m(&self) -> &[[f32; 3]; NODES_MAX] {
        &self.nodes_m
    }

    /// The same flap moved by `way_m`, m.
    #[must_use]
    pub fn moved(mut self, way_m: [f32; 3]) -> Self {
        for node_m in &mut self.nodes_m {
            *node_m = core::array::from_fn(|axis| node_m[axis] + way_m[axis]);
        }
        self
    }

    /// Where the nodes are, as many as there is room for, scene frame, m.
    pub fn nodes(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        self.nodes_m
            .iter()
            .map(|at| Vector3::from(at.map(f64::from)))
    }

    /// Material coordinates of the mark, m.
    #[must_use]
    pub const fn mark_m(&self) -> [f64; 2] {
        self.mark_m
    }
}
