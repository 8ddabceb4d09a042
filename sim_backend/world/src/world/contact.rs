//! One contact in one sub-step: a compliant normal and Coulomb friction, as a convex cost of the
//! relative velocity.
//!
//! Shape: the gap closes at the contact's velocity, so the force at the *end* of a sub-step is `k
//! (-gap - h v_n) - c v_n`, never a pull. Friction is regularised: it sticks up to a slip that is
//! `SLIP` of what the contact's impulse would do to the free masses. A pad is no point: spin about
//! the normal rubs at the radius of the patch, so that what two fingers hold between them does not
//! swing about the line through them. All together is the projection of a linear impulse onto the
//! friction cone in the norm of the compliance, which is the gradient of a convex function; its
//! minimum is the sub-step's velocity.
//!
//! Sources: Castro, Permenter, Han, "An unconstrained convex formulation of compliant contact",
//! IEEE T-RO 2023; Howe, Cutkosky, "Practical force-motion models for sliding manipulation", IJRR
//! 1996 (sliding and spinning as an ellipsoid).

use nalgebra::{Matrix4, Vector3, Vector4};

use super::config::Surface;
use crate::plant::AXIS_COUNT;

/// Degrees of freedom of a thing: the velocity of its centre of mass, and its angular velocity, in
/// the scene.
pub(super) const THING_DOF: usize = 6;

/// Slip at the edge of sticking, as a share of the velocity that the impulse gives to the masses in
/// contact.
const SLIP: f64 = 1e-4;

/// What has a part in a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// What does not move.
    Ground,
    /// A part of an arm's instrument.
    Part {
        /// The arm.
        arm: usize,
        /// 0 left finger, 1 right finger, 2 wrist.
        part: usize,
    },
    /// A thing.
    RigidBody(usize),
}

/// A contact point.
#[derive(Clone, Debug)]
pub(super) struct Contact {
    /// From `sides[0]` to `sides[1]`.
    pub(super) sides: [Side; 2],
    /// Scene frame, m.
    pub(super) point: Vector3<f64>,
    /// Unit normal from the first side to the second one.
    pub(super) normal: Vector3<f64>,
    /// Distance along the normal, m; negative where they overlap.
    pub(super) gap_m: f64,
    /// How they meet.
    pub(super) surface: Surface,
    /// Velocity of the second side relative to the first that friction aims at, m/s: 0, or back to
    /// where they stuck.
    pub(super) homing: Vector3<f64>,
    /// The same of their spin about the normal, rad/s.
    pub(super) spin: f64,
}

/// Directions of a contact: the normal, two tangents, and spin about the normal at the patch's
/// radius.
pub(super) const DIRECTIONS: usize = 4;

/// A contact with everything that a sub-step's solution needs.
pub(super) struct Row {
    /// A row a direction; a column for each actuator of the arm, if there is one.
    pub(super) arm: Option<(usize, [[f64; AXIS_COUNT]; DIRECTIONS])>,
    /// The same for the thing.
    pub(super) thing: Option<(usize, [[f64; THING_DOF]; DIRECTIONS])>,
    /// The contact in the step's list.
    pub(super) contact: usize,
    /// Gap now, m.
    pub(super) gap_m: f64,
    /// Sum of the normal impulses of the step so far, N s.
    pub(super) impulse: f64,
    surface: Surface,
    /// Velocities that friction aims at, m/s.
    target: [f64; DIRECTIONS - 1],
    tangent_mobility: f64,
}

/// A friction cone in one sub-step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cone {
    /// Velocity at which there is no impulse, m/s.
    rest: Vector4<f64>,
    /// Inverse compliance along the normal and across, kg.
    stiff: [f64; 2],
    friction: f64,
}

impl Row {
    /// The contact number `contact` with its Jacobian in `frame`; `tangent_mobility` is the mean of
    /// both tangents', 1/kg.
    pub(super) fn new(
        (contact, from): (usize, &Contact),
        frame: &[Vector3<f64>; 3],
        arm: Option<(usize, [[f64; AXIS_COUNT]; DIRECTIONS])>,
        thing: Option<(usize, [[f64; THING_DOF]; DIRECTIONS])>,
        tangent_mobility: f64,
    ) -> Self {
        Self {
            arm,
            thing,
            contact,
            gap_m: from.gap_m,
            impulse: 0.0,
            surface: from.surface,
            target: [
                from.homing.dot(&frame[1]),
                from.homing.dot(&frame[2]),
                from.spin * from.surface.patch_m,
            ],
            tangent_mobility,
        }
    }

    /// The cone of a sub-step of `step_s`.
    pub(super) fn cone(&self, step_s: f64) -> Cone {
        let along = self.surface.stiffness_n_m * step_s + self.surface.damping_n_s_m;
        let [first, second, spin] = self.target;
        let closed = -self.surface.stiffness_n_m * self.gap_m / along;
        Cone {
            rest: Vector4::new(closed, first, second, spin),
            stiff: [step_s * along, 1.0 / (SLIP * self.tangent_mobility)],
            friction: self.surface.friction,
        }
    }
}

impl Cone {
    /// Impulse at the velocity `v`, N s.
    pub(super) fn impulse(&self, v: &Vector4<f64>) -> Vector4<f64> {
        self.project(v).0
    }

    /// Impulse at the velocity `v`, and minus its derivative by the velocity, kg: symmetric,
    /// positive semidefinite.
    pub(super) fn impulse_and_slope(&self, v: &Vector4<f64>) -> (Vector4<f64>, Matrix4<f64>) {
        let (impulse, region) = self.project(v);
        let [along, across] = self.stiff;
        let slope = match region {
            Region::Free => Matrix4::zeros(),
            Region::Stick => Matrix4::from_diagonal(&Vector4::new(along, across, across, across)),
            Region::Slide { pull, length } => self.slide_slope(impulse.x, &pull, length),
        };
        (impulse, slope)
    }

    /// Minus the derivative of the impulse of a sliding contact with the normal impulse `normal`:
    /// `pull` is the direction of friction times `length`.
    fn slide_slope(&self, normal: f64, pull: &Vector3<f64>, length: f64) -> Matrix4<f64> {
        let [along, across] = self.stiff;
        let mu = self.friction;
        let direction = pull / length;
        // d(impulse)/d(linear impulse), times the linear impulse's own slope.
        let ratio = mu * along / across;
        let share = 1.0 / (1.0 + mu * ratio);
        let mut slope = Matrix4::zeros();
        slope[(0, 0)] = share * along;
        for i in 0..3 {
            slope[(0, 1 + i)] = share * mu * along * direction[i];
            slope[(1 + i, 0)] = slope[(0, 1 + i)];
            for j in 0..3 {
                let parallel = direction[i] * direction[j];
                let kronecker = if i == j { 1.0 } else { 0.0 };
                slope[(1 + i, 1 + j)] = mu * share * mu * along * parallel
                    + mu * normal / length * across * (kronecker - parallel);
            }
        }
        slope
    }

    fn project(&self, v: &Vector4<f64>) -> (Vector4<f64>, Region) {
        let [along, across] = self.stiff;
        let normal = along * (self.rest.x - v.x);
        let pull = (self.rest - v).fixed_rows::<3>(1) * across;
        let length = pull.norm();
        let mu = self.friction;
        if length <= mu * normal {
            return (Vector4::new(normal, pull.x, pull.y, pull.z), Region::Stick);
        }
        // The ratio of the compliances, across over along, says how much sliding feeds back into
        // the normal.
        let ratio = mu * along / across;
        if normal <= -ratio * length {
            return (Vector4::zeros(), Region::Free);
        }
        let normal = (normal + ratio * length) / (1.0 + mu * ratio);
        let drag = pull * (mu * normal / length);
        (
            Vector4::new(normal, drag.x, drag.y, drag.z),
            Region::Slide { pull, length },
        )
    }
}

enum Region {
    Free,
    Stick,
    Slide { pull: Vector3<f64>, length: f64 },
}

/// A right-handed frame whose first axis is `normal`.
pub(super) fn frame(normal: &Vector3<f64>) -> [Vector3<f64>; 3] {
    let away = if normal.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let first = (away - normal * away.dot(normal)).normalize();
    [*normal, first, normal.cross(&first)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cone() -> Cone {
        Cone {
            rest: Vector4::new(0.02, 0.001, -0.003, 0.002),
            stiff: [0.6, 2.0],
            friction: 0.6,
        }
    }

    fn samples() -> impl Iterator<Item = Vector4<f64>> {
        (1..4000_u32).map(|index| {
            let wave = |rate: f64| (f64::from(index) * rate).sin();
            let about = Vector4::new(wave(0.7), wave(1.3), wave(2.1), wave(3.7));
            cone().rest + about.component_mul(&Vector4::new(0.03, 0.004, 0.005, 0.003))
        })
    }

    #[test]
    fn impulses_lie_in_the_friction_cone() {
        let mut seen = [0; 3];
        for v in samples() {
            let (impulse, region) = cone().project(&v);
            let drag = impulse.fixed_rows::<3>(1).norm();
            assert!(impulse.x >= 0.0 && drag <= 0.6 * impulse.x + 1e-15);
            seen[match region {
                Region::Free => 0,
                Region::Stick => 1,
                Region::Slide { .. } => 2,
            }] += 1;
        }
        assert!(seen.iter().all(|&count| count > 50), "{seen:?}");
    }

    #[test]
    fn slope_is_minus_the_derivative_of_the_impulse() {
        let step = 1e-9;
        for v in samples() {
            let (_, slope) = cone().impulse_and_slope(&v);
            assert!((slope - slope.transpose()).norm() < 1e-12);
            for axis in 0..DIRECTIONS {
                let mut nudge = Vector4::zeros();
                nudge[axis] = step;
                let there = cone().impulse(&(v + nudge)) - cone().impulse(&(v - nudge));
                let found = -there / (2.0 * step);
                let apart = (found - slope.column(axis)).norm();
                assert!(apart < 1e-4 * (1.0 + slope.norm()), "{v} {axis}: {apart}");
            }
        }
    }
}
