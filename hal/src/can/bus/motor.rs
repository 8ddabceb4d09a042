//! What an emulated drive turns.

use crate::can::node::{Demand, Feedback};

/// A motor: goes where it is told, as well as it can.
pub trait Motor {
    /// Lets `step_ns` pass under `demand` and tells where the motor is then.
    fn step(&mut self, step_ns: u64, demand: &Demand) -> Feedback;
}

/// A motor without inertia: always where it should be, unless it is stuck or was never told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IdealMotor {
    /// Where it is, counts.
    pub position_counts: f64,
    /// Whether it is stuck there.
    pub stuck: bool,
}

impl Motor for IdealMotor {
    fn step(&mut self, _step_ns: u64, demand: &Demand) -> Feedback {
        let moves = demand.torque && !self.stuck;
        if moves {
            self.position_counts = demand.position_counts;
        }
        Feedback {
            position_counts: self.position_counts,
            velocity_counts_s: if moves { demand.velocity_counts_s } else { 0.0 },
            torque_per_mille: 0.0,
        }
    }
}
