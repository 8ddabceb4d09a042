//! Hot path: bounded, no allocation, no I/O, no lock. The contact of a sheet with the ground below
//! it, and how friction goes on from one sub-step to the next.

use nalgebra::Vector3;

use super::ground::{ContactParameters, Ground, Plane};
use super::sheet::Sheet;

/// A node that may touch the ground during this millisecond.
#[derive(Clone, Copy, Debug)]
struct Near {
    node: usize,
    area_m2: f64,
    plane: Plane,
    load_n: f64,
}

/// The contact of a sheet with its ground.
#[derive(Clone, Debug)]
pub(super) struct Bed {
    ground: Ground,
    touch: ContactParameters,
    damping_n_s_m3: f64,
    half_thickness_m: f64,
    near: Vec<Near>,
    /// Velocity that friction gave each node in the last sub-step, m/s.
    rubs: Vec<Vector3<f64>>,
    depth_m: f64,
}

/// Nodes further above the ground than this cannot reach it within a millisecond, m.
const REACH_M: f64 = 0.004;

/// Depth from which on the pressure grows no more, m: what got below the ground somehow comes up
/// without a shot.
const DEPTH_M_MAX: f64 = 0.002;

impl Bed {
    pub(super) fn new(ground: Ground, touch: &ContactParameters, sheet: &Sheet) -> Self {
        Self {
            ground,
            touch: *touch,
            damping_n_s_m3: touch.damping_n_s_m3(sheet.material.mass_kg_m2()),
            half_thickness_m: 0.5 * sheet.material.thickness_m,
            near: Vec::with_capacity(sheet.positions.len()),
            rubs: vec![Vector3::zeros(); sheet.positions.len()],
            depth_m: 0.0,
        }
    }

    /// Whether its heights were measured.
    pub(super) const fn is_measured(&self) -> bool {
        self.ground.is_measured()
    }

    /// Height of the bare ground, m.
    pub(super) fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        self.ground.height_m(x, y)
    }

    /// Finds what may touch during the next millisecond.
    pub(super) fn begin(&mut self, sheet: &Sheet) {
        self.near.clear();
        self.depth_m = 0.0;
        let per_kg = sheet.material.mass_kg_m2().recip();
        for (node, at) in sheet.positions.iter().enumerate() {
            if sheet.inverse_masses[node] <= 0.0 {
                continue;
            }
            if let Some(plane) = self.ground.plane(at.x, at.y)
                && at.z - plane.point.z < REACH_M
            {
                let area_m2 = sheet.masses[node] * per_kg;
                self.near.push(Near {
                    node,
                    area_m2,
                    plane,
                    load_n: 0.0,
                });
            } else {
                self.rubs[node] = Vector3::zeros();
            }
        }
    }

    /// Adds the ground's pressure to the sheet's forces.
    pub(super) fn press(&mut self, sheet: &mut Sheet) {
        for near in &mut self.near {
            let normal = near.plane.normal;
            let gap_m = (sheet.positions[near.node] - near.plane.point).dot(&normal);
            let depth_m = self.half_thickness_m - gap_m;
            near.load_n = 0.0;
            if depth_m > 0.0 {
                self.depth_m = self.depth_m.max(depth_m);
                let rising = sheet.velocities[near.node].dot(&normal);
                let pressure = self.touch.stiffness_n_m3 * depth_m.min(DEPTH_M_MAX)
                    - self.damping_n_s_m3 * rising;
                near.load_n = (pressure * near.area_m2).max(0.0);
                sheet.forces[near.node] += normal * near.load_n;
            }
        }
    }

    /// Gives the touching nodes the friction of the last sub-step again; see [`held_back`].
    pub(super) fn rub_as_before(&mut self, sheet: &mut Sheet) {
        for near in &self.near {
            if near.load_n > 0.0 {
                sheet.velocities[near.node] += self.rubs[near.node];
            } else {
                self.rubs[near.node] = Vector3::zeros();
            }
        }
    }

    /// Corrects the friction by as much of what still slides as it can take in `dt_s`.
    pub(super) fn rub(&mut self, sheet: &mut Sheet, dt_s: f64) {
        for near in &self.near {
            if near.load_n > 0.0 {
                let normal = near.plane.normal;
                let velocity = &mut sheet.velocities[near.node];
                let sliding = *velocity - normal * velocity.dot(&normal);
                let most =
                    self.touch.friction * near.load_n * dt_s * sheet.inverse_masses[near.node];
                let rub = held_back(&self.rubs[near.node], &sliding, &normal, most);
                *velocity += rub - self.rubs[near.node];
                self.rubs[near.node] = rub;
            }
        }
    }

    /// Numbers that decide the future, for hashing.
    pub(super) fn state(&self) -> impl Iterator<Item = f64> + '_ {
        self.rubs.iter().flat_map(|rub| [rub.x, rub.y, rub.z])
    }

    /// Deepest that the sheet sank into the ground since [`Self::begin`], m.
    pub(super) const fn depth_m(&self) -> f64 {
        self.depth_m
    }
}

/// The change of velocity by friction in one sub-step: what it was in the last one, `before`, and
/// on top whatever stops the `sliding` that is left, together no more than `most`.
///
/// Going on from the last sub-step is what lets two surfaces pull at one node, a finger above and
/// the organ below, until the weaker one slips; starting from nothing, the one that is asked last
/// would always win.
#[inline]
pub(super) fn held_back(
    before: &Vector3<f64>,
    sliding: &Vector3<f64>,
    normal: &Vector3<f64>,
    most: f64,
) -> Vector3<f64> {
    let wanted = before - normal * before.dot(normal) - sliding;
    let size = wanted.norm();
    if size <= most {
        wanted
    } else {
        wanted * (most / size)
    }
}
