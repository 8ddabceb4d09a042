//! The places where the instrument may be, as bounds on single numbers.

use hal::ArmCommand;
use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Point3;

use super::chain::{Instrument, distance_to_segment};
use super::limits::Limits;

/// A bound on one side of a value.
pub(super) struct Boundary {
    pub(super) name: String,
    pub(super) value: f64,
    pub(super) bound: f64,
    /// 1 if the value must be at least the bound, -1 if at most.
    pub(super) sign: f64,
    /// How much worse a value may get that was outside when the arm was enabled.
    recovery: f64,
}

impl Boundary {
    const fn at_least(name: String, value: f64, bound: f64, recovery: f64) -> Self {
        Self {
            name,
            value,
            bound,
            sign: 1.0,
            recovery,
        }
    }

    const fn at_most(name: String, value: f64, bound: f64, recovery: f64) -> Self {
        Self {
            name,
            value,
            bound,
            sign: -1.0,
            recovery,
        }
    }

    /// How far outside the first command of an enabled arm is, and may get.
    pub(super) fn allowance(&self) -> f64 {
        let outside = self.sign * (self.bound - self.value);
        if outside > 0.0 {
            outside + self.recovery
        } else {
            0.0
        }
    }
}

/// Every boundary and where the command is.
pub(super) fn boundaries(limits: &Limits, command: &ArmCommand, at: &Instrument) -> Vec<Boundary> {
    let mut all = Vec::new();
    for (axis, limit) in limits.axes.iter().enumerate() {
        let value = command
            .position
            .get(axis)
            .copied()
            .unwrap_or(command.jaw_position);
        all.push(Boundary::at_least(
            format!("{}.low", limit.name),
            value,
            limit.low,
            0.0,
        ));
        all.push(Boundary::at_most(
            format!("{}.high", limit.name),
            value,
            limit.high,
            0.0,
        ));
    }
    let recovery_m = limits.recovery_m;
    for (name, point) in [
        ("control_point", &at.control_point),
        ("finger_tips", &at.finger_tips),
    ] {
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let (low, high) = (limits.box_low_m[axis], limits.box_high_m[axis]);
            let value = point[axis];
            all.push(Boundary::at_least(
                format!("workspace.{name}.{letter}_min"),
                value,
                low,
                recovery_m,
            ));
            all.push(Boundary::at_most(
                format!("workspace.{name}.{letter}_max"),
                value,
                high,
                recovery_m,
            ));
        }
    }
    for sphere in &limits.spheres {
        let center = Point3::from(sphere.center_m);
        let links = [
            ("shaft", Point3::origin(), at.wrist_pitch),
            ("wrist", at.wrist_pitch, at.control_point),
            ("fingers", at.control_point, at.finger_tips),
        ];
        for (part, start, end) in links {
            // Wrist and fingers are thinner than the shaft; they count as thick as it is.
            let value = distance_to_segment(&center, &start, &end) - SHAFT_RADIUS_M;
            let name = format!("forbidden.{}.{part}", sphere.name);
            all.push(Boundary::at_least(name, value, sphere.radius_m, recovery_m));
        }
    }
    all
}
