//! From a target to the joint velocity that one would like. Hot path: bounded, no allocation, no
//! I/O, no lock.
//!
//! Feed-forward of the target's own velocity, plus the error times a gain, slowed where the axis
//! could not brake in time. The feed-forward is the mean over the look-ahead, so that the arm
//! begins to brake before the target does.

use hal::{JOINT_COUNT, JointVector, TipTarget};

use super::config::ControlConfig;
use super::motion::{AXES, Axes, AxisLimits, JAW, MotionState};
use super::viability::viable_speed;
use crate::kinematics::{Frames, inverse_clamped};

/// Shares of acceleration and jerk that the approach to a target counts on; the rest keeps it from
/// overshooting.
const APPROACH_ACCELERATION: f64 = 0.5;
const APPROACH_JERK: f64 = 0.25;

/// The nominal motion stays this far below the limits, so that rounding makes no row of the filter
/// active.
const BELOW_LIMITS: f64 = 0.999;

/// Turns targets into joint velocities.
#[derive(Clone, Debug)]
pub struct Tracking {
    axes: [AxisLimits; AXES],
    low: JointVector,
    high: JointVector,
    gain_1_s: f64,
    tip_speed_m_s: f64,
    tip_angular_speed_rad_s: f64,
}

impl Tracking {
    /// Tracking under `config`.
    #[must_use]
    pub fn new(config: &ControlConfig) -> Self {
        Self {
            axes: config.axes,
            low: JointVector::from_fn(|joint, _| config.axes[joint].low),
            high: JointVector::from_fn(|joint, _| config.axes[joint].high),
            gain_1_s: config.tracking_gain_1_s,
            tip_speed_m_s: config.tip_speed_m_s * config.filter.speed_fraction,
            tip_angular_speed_rad_s: config.tip_angular_speed_rad_s * config.filter.speed_fraction,
        }
    }

    /// The velocity that brings the jaw to `target`, rad/s.
    fn jaw_velocity(&self, state: &MotionState, target: &TipTarget, pace: f64) -> f64 {
        let jaw = target.jaw.clamp(self.axes[JAW].low, self.axes[JAW].high);
        let jaw_max = BELOW_LIMITS * self.axes[JAW].velocity * pace;
        self.approach(JAW, jaw - state.position[JAW])
            .clamp(-jaw_max, jaw_max)
    }

    /// The velocity of each axis that leads from `state` to `target`, which will be at `ahead` in
    /// `ahead_s`.
    ///
    /// Joint and tip speeds are scaled together to within `pace` times their limits, so that the
    /// path keeps its direction. `None` if the target has no inverse kinematics.
    #[must_use]
    pub fn velocity(
        &self,
        state: &MotionState,
        frames: &Frames,
        target: &TipTarget,
        ahead: &TipTarget,
        ahead_s: f64,
        pace: f64,
    ) -> Option<Axes> {
        let joints = self.joints(target, state.position[3])?;
        let later = self.joints(ahead, joints[3])?;
        let mut wanted = JointVector::zeros();
        for joint in 0..JOINT_COUNT {
            let own = (later[joint] - joints[joint]) / ahead_s;
            wanted[joint] = own + self.approach(joint, joints[joint] - state.position[joint]);
        }
        let wanted = wanted * self.scale(&wanted, frames, pace);
        let jaw_velocity = self.jaw_velocity(state, target, pace);
        let mut velocity = [jaw_velocity; AXES];
        velocity[..JOINT_COUNT].copy_from_slice(wanted.as_slice());
        Some(velocity)
    }

    fn joints(&self, target: &TipTarget, near_roll: f64) -> Option<JointVector> {
        inverse_clamped(&target.tip_in_rcm(), near_roll, &self.low, &self.high)
            .ok()
            .map(|(joints, _)| joints)
    }

    /// Velocity that takes an axis over `error` to rest.
    fn approach(&self, axis: usize, error: f64) -> f64 {
        let limits = &self.axes[axis];
        let distance = error.abs();
        let brakable = viable_speed(
            distance,
            APPROACH_ACCELERATION * limits.acceleration,
            APPROACH_JERK * limits.jerk,
        );
        (self.gain_1_s * distance)
            .min(brakable)
            .min(BELOW_LIMITS * limits.velocity)
            .copysign(error)
    }

    fn scale(&self, wanted: &JointVector, frames: &Frames, pace: f64) -> f64 {
        let twist = frames.tip_jacobian() * wanted;
        let share = BELOW_LIMITS * pace;
        let least = |limit: f64, speed: f64| share * limit / speed.max(1e-12);
        let moving = least(self.tip_speed_m_s, twist.fixed_rows::<3>(0).norm());
        let turning = least(
            self.tip_angular_speed_rad_s,
            twist.fixed_rows::<3>(3).norm(),
        );
        (0..JOINT_COUNT).fold(moving.min(turning).min(1.0), |scale, joint| {
            scale.min(least(self.axes[joint].velocity, wanted[joint].abs()))
        })
    }
}
