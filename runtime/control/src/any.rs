//! The controller of as many arms as the configuration has. Hot path: bounded, no allocation, no
//! I/O, no clock, no lock.

use super::config::ControlConfig;
use super::controller::{Controller, ControllerError};
use super::filter::Problem;
use super::guard::MeasuredClearance;
use super::report::{TickInput, TickOutput};
use super::rows::Velocities;
use super::snapshot::{HeldChunk, Snapshot, SnapshotError};
use hal::{Chunk, PerArm};

/// A controller of one arm or of two.
#[derive(Debug)]
pub enum AnyController {
    /// Of one arm.
    One(Box<Controller<1>>),
    /// Of two that share a scene.
    Two(Box<Controller<2>>),
}

impl AnyController {
    /// A disabled controller of the arms of `config`.
    ///
    /// # Errors
    /// [`ControllerError`] if there is no controller of so many arms, or none of these.
    pub fn new(config: &ControlConfig) -> Result<Self, ControllerError> {
        Ok(if config.arms.len() == 2 {
            Self::Two(Box::new(Controller::for_arms(config)?))
        } else {
            Self::One(Box::new(Controller::for_arms(config)?))
        })
    }

    /// How many arms there are.
    #[must_use]
    pub const fn arm_count(&self) -> usize {
        match self {
            Self::One(_) => 1,
            Self::Two(_) => 2,
        }
    }

    /// One control period of all arms, as [`Controller::tick_arms`].
    ///
    /// # Panics
    /// If `inputs` have another number of arms than [`Self::arm_count`]: who has them from a log,
    /// or from a rig of another's, compares the numbers first.
    #[expect(clippy::panic, reason = "the caller compares the numbers first")]
    pub fn tick(&mut self, inputs: &PerArm<TickInput<'_>>) -> PerArm<TickOutput> {
        match (self, inputs.second) {
            (Self::One(controller), None) => PerArm::one(controller.tick(&inputs.first)),
            (Self::Two(controller), Some(second)) => {
                let [first, second] = controller.tick_arms(&[inputs.first, second]);
                PerArm::two(first, second)
            }
            (Self::One(_), Some(_)) => panic!("inputs of two arms for a controller of one"),
            (Self::Two(_), None) => panic!("inputs of one arm for a controller of two"),
        }
    }

    /// As [`Controller::save`].
    pub fn save(&self, to: &mut Snapshot) {
        match self {
            Self::One(controller) => controller.save(to),
            Self::Two(controller) => controller.save(to),
        }
    }

    /// As [`Controller::restore`].
    ///
    /// # Errors
    /// [`SnapshotError`]; the controller is of no use then.
    pub fn restore(&mut self, snapshot: &Snapshot, chunks: &[Chunk]) -> Result<(), SnapshotError> {
        match self {
            Self::One(controller) => controller.restore(snapshot, chunks),
            Self::Two(controller) => controller.restore(snapshot, chunks),
        }
    }

    /// As [`Controller::held`].
    #[must_use]
    pub fn held(&self, held: &HeldChunk) -> Option<&Chunk> {
        match self {
            Self::One(controller) => controller.held(held),
            Self::Two(controller) => controller.held(held),
        }
    }

    /// As [`Controller::measured_clearances`].
    #[must_use]
    pub fn measured_clearances(&self) -> Vec<MeasuredClearance> {
        match self {
            Self::One(controller) => controller.measured_clearances(),
            Self::Two(controller) => controller.measured_clearances(),
        }
    }

    /// As [`Controller::following_errors_m`].
    #[must_use]
    pub fn following_errors_m(&self) -> Vec<f64> {
        match self {
            Self::One(controller) => controller.following_errors_m().to_vec(),
            Self::Two(controller) => controller.following_errors_m().to_vec(),
        }
    }

    /// As [`Controller::problem`].
    #[must_use]
    pub const fn problem(&self) -> &Problem {
        match self {
            Self::One(controller) => controller.problem(),
            Self::Two(controller) => controller.problem(),
        }
    }

    /// As [`Controller::solution`].
    #[must_use]
    pub const fn solution(&self) -> &Velocities {
        match self {
            Self::One(controller) => controller.solution(),
            Self::Two(controller) => controller.solution(),
        }
    }
}
