//! Hot path: bounded, no allocation, no I/O, no lock. One part of the instrument pushing the sheet:
//! pressure at samples, friction at nodes, and what the part feels.
//!
//! Penalty contact, explicit like the sheet: at each sample of the sheet's middle surface within
//! the half thickness of a part's skin the pressure is
//! `stiffness * depth - damping * leaving speed`, never below 0, times the sample's area, given to
//! the nodes around by their bilinear shares. Friction is Coulomb's, by impulses on nodes after the
//! forces.

use nalgebra::Vector3;

use super::bed::held_back;
use super::ground::ContactParameters;
use super::jaw::{Motion, Solid, Wrench};
use super::samples::Samples;
use super::sheet::Sheet;
use hal::Pose;

/// Samples further away than this from a part's skin cannot reach it within a millisecond, m.
const REACH_M: f64 = 0.002;
/// A part and its touch.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// Its shape, in its own frame.
    solid: Solid,
    /// Contact stiffness, N/m^3, and friction.
    touch: ContactParameters,
    /// Contact damping by area, N s/m^3, for the mass of this sheet.
    damping_n_s_m3: f64,
    /// Half the sheet's thickness: closer to its middle surface than this there is contact, m.
    half_thickness_m: f64,
    /// From the pose at the start of the millisecond to that at its end.
    motion: Motion,
    /// Samples that the part may reach in this millisecond.
    near: Vec<usize>,
    /// Nodes that this sub-step's pressure has reached, in the order in which it did.
    touched: Vec<usize>,
    /// Those of the sub-step before, whose friction is tried first.
    touched_before: Vec<usize>,
    /// Velocity that friction gave each node in the last sub-step, m/s.
    rubs: Vec<Vector3<f64>>,
    /// By node, N: the normal force of this sub-step; 0 where nothing touches.
    loads_n: Vec<f64>,
    /// By node, N: sum of the normal forces, whose direction is the mean normal.
    normals: Vec<Vector3<f64>>,
    /// Sums since the millisecond began.
    felt: Felt,
}

/// What a part felt in one millisecond, as means over its sub-steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Felt {
    /// On the part, about the hinge.
    pub(super) wrench: Wrench,
    /// Sum of the normal forces, N.
    pub(super) load_n: f64,
    /// Deepest overlap with the sheet's thickness, m.
    pub(super) depth_m: f64,
}

impl Felt {
    pub(super) const fn nothing() -> Self {
        Self {
            wrench: Wrench::zero(),
            load_n: 0.0,
            depth_m: 0.0,
        }
    }
}

impl Part {
    pub(super) fn new(
        solid: Solid,
        touch: &ContactParameters,
        pose: &Pose,
        sheet: &Sheet,
        samples: &Samples,
    ) -> Self {
        let nodes = sheet.positions.len();
        Self {
            solid,
            touch: *touch,
            damping_n_s_m3: touch.damping_n_s_m3(sheet.material.mass_kg_m2()),
            half_thickness_m: 0.5 * sheet.material.thickness_m,
            motion: Motion::new(pose, pose, 1.0),
            near: Vec::with_capacity(samples.len()),
            touched: Vec::with_capacity(nodes),
            touched_before: Vec::with_capacity(nodes),
            rubs: vec![Vector3::zeros(); nodes],
            loads_n: vec![0.0; nodes],
            normals: vec![Vector3::zeros(); nodes],
            felt: Felt::nothing(),
        }
    }

    /// Changes the part's shape.
    pub(super) const fn reshape(&mut self, solid: Solid) {
        self.solid = solid;
    }

    /// Begins a millisecond in which the part moves to `pose`; the samples marked in `held` do not
    /// touch it.
    pub(super) fn begin(
        &mut self,
        pose: &Pose,
        dt_s: f64,
        sheet: &Sheet,
        samples: &Samples,
        held: &[bool],
    ) {
        self.motion = Motion::new(&self.motion.at(1.0), pose, dt_s);
        self.felt = Felt::nothing();
        self.near.clear();
        let (middle, radius_m) = self.solid.ball();
        let middle = (pose * nalgebra::Point3::from(middle)).coords;
        let Self {
            solid,
            near,
            half_thickness_m,
            ..
        } = self;
        samples.around(
            sheet,
            &middle,
            radius_m + *half_thickness_m + REACH_M,
            |index, point| {
                if !held[index] {
                    let local = pose.inverse_transform_point(&point.of(&sheet.positions).into());
                    if solid.distance_m(&local.coords).0 < *half_thickness_m + REACH_M {
                        near.push(index);
                    }
                }
            },
        );
    }

    /// Adds the part's pressure at the share `share` of the millisecond to the sheet's forces.
    pub(super) fn press(
        &mut self,
        sheet: &mut Sheet,
        samples: &Samples,
        share: f64,
        centre: &Vector3<f64>,
    ) {
        if self.near.is_empty() {
            return;
        }
        let pose = self.motion.at(share);
        for &index in &self.near {
            let point = samples.get(index);
            let at = point.of(&sheet.positions);
            let local = pose.inverse_transform_point(&at.into()).coords;
            let (distance_m, normal) = self.solid.distance_m(&local);
            let depth_m = self.half_thickness_m - distance_m;
            if depth_m <= 0.0 {
                continue;
            }
            let normal = pose.rotation * normal;
            let leaving =
                (point.of(&sheet.velocities) - self.motion.velocity(&pose, &at)).dot(&normal);
            let pressure = self.touch.stiffness_n_m3 * depth_m - self.damping_n_s_m3 * leaving;
            let load_n = (pressure * samples.area_m2).max(0.0);
            let force = normal * load_n;
            for (node, weight) in point.shares() {
                sheet.forces[node] += force * weight;
                if self.loads_n[node] <= 0.0 {
                    self.touched.push(node);
                    self.normals[node] = Vector3::zeros();
                    // So small that no friction comes of it; it marks the node as listed.
                    self.loads_n[node] = f64::MIN_POSITIVE;
                }
                self.loads_n[node] += load_n * weight;
                self.normals[node] += force * weight;
            }
            self.felt.wrench.push(&(at - centre), &-force);
            self.felt.load_n += load_n;
            self.felt.depth_m = self.felt.depth_m.max(depth_m);
        }
    }

    /// Gives the pressed nodes the friction of the last sub-step again; see [`held_back`].
    pub(super) fn rub_as_before(&mut self, sheet: &mut Sheet) {
        for &node in &self.touched_before {
            if self.loads_n[node] > 0.0 {
                sheet.velocities[node] += self.rubs[node];
            } else {
                self.rubs[node] = Vector3::zeros();
            }
        }
    }

    /// Corrects the friction of the pressed nodes by as much of what still slides as it can take in
    /// `dt_s`.
    pub(super) fn rub(&mut self, sheet: &mut Sheet, share: f64, dt_s: f64, centre: &Vector3<f64>) {
        core::mem::swap(&mut self.touched, &mut self.touched_before);
        self.touched.clear();
        if self.touched_before.is_empty() {
            return;
        }
        let pose = self.motion.at(share);
        for &node in &self.touched_before {
            let normal = self.normals[node] / self.normals[node].norm().max(f64::MIN_POSITIVE);
            let at = sheet.positions[node];
            let past = sheet.velocities[node] - self.motion.velocity(&pose, &at);
            let sliding = past - normal * past.dot(&normal);
            let most = self.touch.friction * self.loads_n[node] * dt_s * sheet.inverse_masses[node];
            let rub = held_back(&self.rubs[node], &sliding, &normal, most);
            sheet.velocities[node] += rub - self.rubs[node];
            self.rubs[node] = rub;
            let force = rub * (-sheet.masses[node] / dt_s);
            self.felt.wrench.push(&(at - centre), &force);
            self.loads_n[node] = 0.0;
        }
    }

    /// Numbers that decide the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        self.rubs.iter().flat_map(|rub| [rub.x, rub.y, rub.z])
    }

    /// What the part felt since [`Self::begin`], over `substeps` sub-steps.
    pub(super) fn felt(&self, substeps: f64) -> Felt {
        Felt {
            wrench: self.felt.wrench.scaled(substeps.recip()),
            load_n: self.felt.load_n / substeps,
            depth_m: self.felt.depth_m,
        }
    }
}
