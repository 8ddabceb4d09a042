//! Hot path: bounded, no allocation, no I/O, no lock. A thin elastic sheet as a grid of mass
//! points: where they are, how they move, and the step that moves them.

mod bending;
mod membrane;

use hal::Pose;
use nalgebra::{Point3, Vector3};

use super::material::Material;

/// A rectangular sheet in its rest state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetShape {
    /// Size along the material's u and v axes, m.
    pub size_m: [f64; 2],
    /// Cells along u and v, each at least 1.
    pub cells: [usize; 2],
}

/// The state of a sheet. Node `[i, j]`, `i` along u and `j` along v, is number `j * nodes[0] + i`.
#[derive(Clone, Debug)]
pub struct Sheet {
    pub(super) nodes: [usize; 2],
    pub(super) spacing_m: [f64; 2],
    pub(super) material: Material,
    pub(super) gravity: Vector3<f64>,
    pub(super) positions: Vec<Vector3<f64>>,
    pub(super) velocities: Vec<Vector3<f64>>,
    /// Forces of this sub-step, N; contacts add to them between [`Self::load`] and
    /// [`Self::accelerate`].
    pub(super) forces: Vec<Vector3<f64>>,
    pub(super) masses: Vec<f64>,
    /// 0 for a fixed node.
    pub(super) inverse_masses: Vec<f64>,
}

impl Sheet {
    /// A flat sheet at rest: `pose` places its frame, u along x and v along y, the corner `[0, 0]`
    /// at the origin.
    #[must_use]
    pub fn new(
        shape: &SheetShape,
        material: &Material,
        pose: &Pose,
        gravity: Vector3<f64>,
    ) -> Self {
        let nodes = shape.cells.map(|cells| cells + 1);
        let spacing_m = [0, 1].map(|axis| shape.size_m[axis] / count(shape.cells[axis]));
        let mut positions = Vec::with_capacity(nodes[0] * nodes[1]);
        let mut masses = Vec::with_capacity(nodes[0] * nodes[1]);
        let cell_kg = material.mass_kg_m2() * spacing_m[0] * spacing_m[1];
        for j in 0..nodes[1] {
            for i in 0..nodes[0] {
                let local = Point3::new(count(i) * spacing_m[0], count(j) * spacing_m[1], 0.0);
                positions.push((pose * local).coords);
                masses.push(cell_kg * edge_share(i, nodes[0]) * edge_share(j, nodes[1]));
            }
        }
        Self {
            nodes,
            spacing_m,
            material: *material,
            gravity,
            velocities: vec![Vector3::zeros(); positions.len()],
            forces: vec![Vector3::zeros(); positions.len()],
            inverse_masses: masses.iter().map(|mass| mass.recip()).collect(),
            positions,
            masses,
        }
    }

    /// Number of the node `[i, j]`.
    #[must_use]
    pub const fn node(&self, i: usize, j: usize) -> usize {
        j * self.nodes[0] + i
    }

    /// Nodes along u and v.
    #[must_use]
    pub const fn nodes(&self) -> [usize; 2] {
        self.nodes
    }

    /// Where the nodes are, scene frame, m.
    #[must_use]
    pub fn positions(&self) -> &[Vector3<f64>] {
        &self.positions
    }

    /// Keeps a node where it is for good.
    pub fn fix(&mut self, node: usize) {
        self.inverse_masses[node] = 0.0;
        self.velocities[node] = Vector3::zeros();
    }

    /// Starts a sub-step: the forces are those of the sheet's weight, elasticity and damping.
    pub fn load(&mut self) {
        let drag = self.material.drag_per_s;
        for (index, force) in self.forces.iter_mut().enumerate() {
            *force = (self.gravity - self.velocities[index] * drag) * self.masses[index];
        }
        membrane::add_forces(self);
        bending::add_forces(self);
    }

    /// Turns the forces into velocities after `dt_s`.
    pub fn accelerate(&mut self, dt_s: f64) {
        for ((velocity, force), inverse_mass) in self
            .velocities
            .iter_mut()
            .zip(&self.forces)
            .zip(&self.inverse_masses)
        {
            *velocity += force * (dt_s * inverse_mass);
        }
    }

    /// Moves the nodes along their velocities for `dt_s` (after [`Self::accelerate`] this is the
    /// symplectic Euler rule).
    pub fn drift(&mut self, dt_s: f64) {
        for (position, velocity) in self.positions.iter_mut().zip(&self.velocities) {
            *position += velocity * dt_s;
        }
    }

    /// Kinetic, elastic and potential energy, J; the last is zero at the scene's origin.
    #[must_use]
    pub fn energy_j(&self) -> [f64; 3] {
        let mut kinetic = 0.0;
        let mut potential = 0.0;
        for (index, mass) in self.masses.iter().enumerate() {
            kinetic += 0.5 * mass * self.velocities[index].norm_squared();
            potential -= mass * self.gravity.dot(&self.positions[index]);
        }
        [
            kinetic,
            membrane::energy_j(self) + bending::energy_j(self),
            potential,
        ]
    }

    /// Largest stretch of any cell (0.1 is a tenth longer than at rest), never below 0.
    #[must_use]
    pub fn stretch_max(&self) -> f64 {
        (1.0 + 2.0 * membrane::green_max(self).max(0.0)).sqrt() - 1.0
    }

    /// Angular frequency of the fastest free oscillation about the present state, rad/s, found by
    /// power iteration.
    ///
    /// Undamped, sub-steps shorter than 2 over this are stable.
    #[must_use]
    pub fn fastest_rad_s(&self) -> f64 {
        let mut probe = self.clone();
        probe.gravity = Vector3::zeros();
        probe.material.relaxation_s = 0.0;
        probe.material.drag_per_s = 0.0;
        probe.velocities.fill(Vector3::zeros());
        let mut shape: Vec<Vector3<f64>> = (0..self.positions.len())
            .map(|index| {
                let at = count(index);
                Vector3::new((1.3 * at).sin(), (2.1 * at).cos(), (0.7 * at * at).sin())
            })
            .collect();
        let mut square = 0.0;
        for _ in 0..POWER_ITERATIONS {
            let scale = PROBE_M / norm(&shape);
            shape.iter_mut().for_each(|part| *part *= scale);
            let pulled = |probe: &mut Self, sign: f64| {
                for (index, part) in shape.iter().enumerate() {
                    probe.positions[index] = self.positions[index] + part * sign;
                }
                probe.load();
                probe.forces.clone()
            };
            let (ahead, behind) = (pulled(&mut probe, 1.0), pulled(&mut probe, -1.0));
            for (index, part) in shape.iter_mut().enumerate() {
                *part = (behind[index] - ahead[index]) * (0.5 * self.inverse_masses[index]);
            }
            square = norm(&shape) / PROBE_M;
        }
        square.sqrt()
    }
}

/// Rounds of the power iteration; 60 leave less than 2 % (tested against a grid's known spectrum).
const POWER_ITERATIONS: usize = 60;
/// Size of the displacement that measures stiffness, m over all nodes.
const PROBE_M: f64 = 1e-7;

fn norm(shape: &[Vector3<f64>]) -> f64 {
    shape.iter().map(Vector3::norm_squared).sum::<f64>().sqrt()
}

/// The longest stable sub-step of an oscillation of angular frequency squared `fastest` (1/s²)
/// whose damping lags by `lag_s`, s.
pub(super) fn longest_step_s(fastest: f64, lag_s: f64) -> f64 {
    // With the forces of the old velocities the rule is stable while fastest (dt² + 2 lag dt) < 4.
    (lag_s * lag_s + 4.0 / fastest).sqrt() - lag_s
}

/// A node on the edge of a grid stands for half a cell in that direction.
pub(super) fn edge_share(index: usize, nodes: usize) -> f64 {
    if index == 0 || index + 1 == nodes {
        0.5
    } else {
        1.0
    }
}

/// A count as a number.
#[expect(
    clippy::cast_precision_loss,
    reason = "counts of nodes, far below 2^52"
)]
pub(super) const fn count(number: usize) -> f64 {
    number as f64
}
