//! The seven axes that move together: the joints and the jaw. Hot path: bounded, no allocation, no
//! I/O, no lock.

use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, TimeNs};

use super::snapshot::words;

/// Joints and jaw.
pub const AXES: usize = JOINT_COUNT + 1;

/// Index of the jaw among the axes.
pub const JAW: usize = JOINT_COUNT;

/// One value an axis: joint order, then the jaw; rad (insertion m) and their derivatives.
pub type Axes = [f64; AXES];

/// What one axis may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Lowest position, rad (m).
    pub low: f64,
    /// Highest position, rad (m).
    pub high: f64,
    /// Highest speed, rad/s (m/s).
    pub velocity: f64,
    /// Highest acceleration, rad/s² (m/s²).
    pub acceleration: f64,
    /// Highest jerk, rad/s³ (m/s³).
    pub jerk: f64,
}

/// Where the commanded arm is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// Positions.
    pub position: Axes,
    /// Velocities.
    pub velocity: Axes,
    /// Accelerations.
    pub acceleration: Axes,
}

words!(MotionState {
    position: Axes,
    velocity: Axes,
    acceleration: Axes,
});

impl MotionState {
    /// At rest with every axis at zero.
    pub const ZERO: Self = Self {
        position: [0.0; AXES],
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    };

    /// At rest where `arm` was measured.
    #[must_use]
    pub fn at_rest(arm: &ArmState) -> Self {
        let position = core::array::from_fn(|axis| {
            if axis == JAW {
                arm.jaw_position
            } else {
                arm.position[axis]
            }
        });
        Self {
            position,
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
        }
    }

    /// The joint positions, without the jaw.
    #[must_use]
    pub fn joints(&self) -> JointVector {
        without_jaw(&self.position)
    }

    /// The joint velocities, without the jaw.
    #[must_use]
    pub fn joint_velocity(&self) -> JointVector {
        without_jaw(&self.velocity)
    }

    /// Whether nothing moves.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.velocity
            .iter()
            .chain(&self.acceleration)
            .all(|x| x.abs() < 1e-9)
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.position
            .iter()
            .chain(&self.velocity)
            .chain(&self.acceleration)
            .all(|x| x.is_finite())
    }

    /// The command that realises this state.
    #[must_use]
    pub fn command(&self, stamp: TimeNs, enabled: bool) -> ArmCommand {
        ArmCommand {
            stamp,
            position: self.joints(),
            velocity: self.joint_velocity(),
            acceleration: without_jaw(&self.acceleration),
            jaw_position: self.position[JAW],
            jaw_velocity: self.velocity[JAW],
            enabled,
        }
    }
}

fn without_jaw(axes: &Axes) -> JointVector {
    JointVector::from_fn(|joint, _| axes[joint])
}
