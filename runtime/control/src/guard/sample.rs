//! One moment of a stop. Hot path: bounded, no allocation, no I/O, no lock.

use super::clearance::{Boundaries, Clearances, Wanted};
use crate::instrument::{Instrument, KinematicState};
use crate::motion::{Axes, JAW, MotionState};

/// One moment of a stop.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    /// 10 m where nothing was wanted or there is no region.
    pub(super) clearances: Clearances,
    pub(super) instrument: Instrument,
    pub(super) velocity: Axes,
    pub(super) acceleration: Axes,
    pub(super) jaw: f64,
    /// Of the control point, from the Jacobian.
    pub(super) tip_speed_m_s: f64,
    pub(super) tip_turn_rad_s: f64,
    /// From the remote centre: the lever of yaw and pitch.
    pub(super) wrist_distance_m: f64,
}

impl Sample {
    /// The arm in `state` among `boundaries`.
    pub(super) fn new(state: &MotionState, boundaries: &Boundaries, wanted: &Wanted) -> Self {
        let stance = KinematicState::new(state);
        let twist = stance.frames.tip_jacobian() * state.joint_velocity();
        Self {
            clearances: boundaries.clearances(&stance.instrument, wanted),
            instrument: stance.instrument,
            velocity: state.velocity,
            acceleration: state.acceleration,
            jaw: state.position[JAW],
            tip_speed_m_s: twist.fixed_rows::<3>(0).norm(),
            tip_turn_rad_s: twist.fixed_rows::<3>(3).norm(),
            wrist_distance_m: stance.instrument.wrist_m.norm(),
        }
    }
}
