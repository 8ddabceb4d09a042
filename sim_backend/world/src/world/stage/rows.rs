//! The contacts of a step with their Jacobians.
//!
//! A row gives the velocity of the contact's second side against its first along one axis: normal,
//! two tangents, and the spin about the normal times the radius of the patch, so that all four are
//! in m/s and share one cone. The first side has the sign -, the second +; ground has no columns.

use nalgebra::{Matrix3, Vector3};

use super::Stage;
use crate::plant::AXIS_COUNT;
use crate::world::arm::ArmUnit;
use crate::world::contact::{Row, Side, frame};

impl Stage {
    /// The contacts with their Jacobians, which hold for the whole step.
    ///
    /// Sides that are not solved for (arms not in `coupled`, things not in `awake`) get no columns,
    /// as ground. The mobility of a contact is the inverse effective mass of both sides along a
    /// tangent, the mean of the two, 1/kg.
    pub(super) fn make_rows(
        &mut self,
        arms: &[ArmUnit],
        (coupled, awake): (&[usize], &[usize]),
        inertias: &[[Matrix3<f64>; 2]],
    ) {
        self.rows.clear();
        for (number, contact) in self.contacts.iter().enumerate() {
            let axes = frame(&contact.normal);
            let (mut arm, mut thing) = (None, None);
            let mut mobility = 0.0;
            for (side, sign) in contact.sides.iter().zip([-1.0, 1.0]) {
                match *side {
                    Side::Ground => {}
                    Side::Part { arm: of, part } => {
                        let Some(slot) = coupled.iter().position(|&arm| arm == of) else {
                            continue;
                        };
                        let rows = arms[of].jacobian(part, &contact.point, &axes);
                        let patch_m = contact.surface.patch_m;
                        let [n, t, u, spin] = rows;
                        let scaled =
                            |row: [f64; AXIS_COUNT], scale: f64| row.map(|entry| scale * entry);
                        let [n, t, u] = [n, t, u].map(|row| scaled(row, sign));
                        let rows = [n, t, u, scaled(spin, sign * patch_m)];
                        let drives = &self.masses.drives[AXIS_COUNT * slot..];
                        for row in &rows[1..3] {
                            for (entry, drive) in row.iter().zip(drives) {
                                mobility += 0.5 * entry * entry / drive.inertia;
                            }
                        }
                        arm = Some((slot, rows));
                    }
                    Side::RigidBody(of) => {
                        let Some(slot) = awake.iter().position(|&thing| thing == of) else {
                            continue;
                        };
                        let moving = &self.things[of].moving;
                        let lever = contact.point - moving.centre();
                        let row = |push: Vector3<f64>, turn: Vector3<f64>| {
                            [push.x, push.y, push.z, turn.x, turn.y, turn.z]
                        };
                        let [n, t, u] =
                            axes.map(|axis| row(axis * sign, lever.cross(&axis) * sign));
                        let spin = axes[0] * (sign * contact.surface.patch_m);
                        let rows = [n, t, u, row(Vector3::zeros(), spin)];
                        for axis in &axes[1..] {
                            mobility += 0.5 * moving.mobility(&inertias[slot][1], &lever, axis);
                        }
                        thing = Some((slot, rows));
                    }
                }
            }
            self.rows
                .push(Row::new((number, contact), &axes, arm, thing, mobility));
        }
    }
}
