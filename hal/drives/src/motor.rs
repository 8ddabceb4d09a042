//! What an emulated drive turns.

use crate::node::{Demand, Feedback};

/// A motor: follows its demand as well as it can.
///
/// Called by [`Network`](crate::Network) every 0.5 ms of virtual time and once with no time when
/// the drive is added.
pub trait Motor {
    /// Lets `step_ns` pass under `demand` and tells where the motor is then.
    fn step(&mut self, step_ns: u64, demand: &Demand) -> Feedback;
}

/// A motor without inertia: always where it should be, unless it is stuck or has had no demand.
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

/// A motor that turns elsewhere, together with others: its demand waits here, and so does its
/// feedback.
///
/// Seven drives of one arm turn one plant: the owner of that plant reads the demands, moves it, and
/// leaves the feedback.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terminal {
    /// The newest demand.
    pub demand: Demand,
    /// Where the motor is, as the drive reads it from now on.
    pub feedback: Feedback,
}

impl Terminal {
    /// A motor without torque that is where `feedback` says.
    #[must_use]
    pub const fn new(feedback: Feedback) -> Self {
        let demand = Demand {
            torque: false,
            position_counts: feedback.position_counts,
            velocity_counts_s: 0.0,
            torque_per_mille_max: 0.0,
        };
        Self { demand, feedback }
    }
}

impl Motor for Terminal {
    fn step(&mut self, _step_ns: u64, demand: &Demand) -> Feedback {
        self.demand = *demand;
        self.feedback
    }
}
