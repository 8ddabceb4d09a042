//! The controller as a whole, on an arm that does what it is told.

#[expect(
    clippy::print_stdout,
    clippy::cast_precision_loss,
    reason = "figures for whoever runs them with --nocapture; counts are small"
)]
mod adversary;
#[expect(
    clippy::print_stdout,
    reason = "figures for whoever runs them with --nocapture"
)]
mod following;
mod modes;
#[expect(
    clippy::print_stdout,
    reason = "figures for whoever runs them with --nocapture"
)]
mod planted;
#[expect(
    clippy::print_stdout,
    clippy::cast_precision_loss,
    reason = "figures for whoever runs them with --nocapture; counts are small"
)]
mod scenarios;

use hal::{ArmState, Chunk, JointVector, Pose, TICK_NS, TimeNs, TipTarget};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::config::ControlConfig;
use super::{CommandHash, Controller, OperatorEvent, TickInput, TickOutput};
use crate::kinematics::forward;

/// A policy step.
const STEP_NS: u64 = 40 * TICK_NS;

fn config() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

fn home() -> JointVector {
    JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0)
}

/// A controller with an arm that is wherever it was told to be.
struct Bench {
    controller: Controller,
    arm: ArmState,
    tick: u64,
    hash: CommandHash,
}

impl Bench {
    fn enabled(config: &ControlConfig) -> Self {
        let mut bench = Self::disabled(config);
        bench.step(None, Some(OperatorEvent::Enable));
        bench
    }

    fn disabled(config: &ControlConfig) -> Self {
        let controller = Controller::new(config).unwrap();
        Self {
            controller,
            arm: ArmState::at_rest(TimeNs(0), home(), 0.2),
            tick: 0,
            hash: CommandHash::new(),
        }
    }

    fn now(&self) -> TimeNs {
        TimeNs::from_tick(self.tick)
    }

    fn step(&mut self, chunk: Option<&Chunk>, operator: Option<OperatorEvent>) -> TickOutput {
        self.step_measuring(Ok(self.arm), chunk, operator)
    }

    fn step_measuring(
        &mut self,
        measured: Result<ArmState, hal::ArmError>,
        chunk: Option<&Chunk>,
        operator: Option<OperatorEvent>,
    ) -> TickOutput {
        let output = self.controller.tick(&TickInput {
            now: self.now(),
            measured,
            chunk,
            operator,
        });
        self.hash.add(&output.command);
        self.tick += 1;
        let command = &output.command;
        self.arm = ArmState {
            stamp: self.now(),
            position: command.position,
            velocity: command.velocity,
            effort: JointVector::zeros(),
            jaw_position: command.jaw_position,
            jaw_velocity: command.jaw_velocity,
            jaw_effort: 0.0,
        };
        output
    }

    fn tip(&self) -> Pose {
        forward(&self.arm.position)
    }

    /// A chunk observed now that follows `path`, a function of the time in seconds.
    fn chunk_along(&self, path: impl Fn(f64) -> TipTarget) -> Chunk {
        let mut chunk = Chunk::new(self.now(), self.tick + 1, STEP_NS, &[path(0.0); 100]);
        for index in 0..100 {
            chunk.targets[index] = path(chunk.due(index).seconds());
        }
        chunk
    }
}

fn pose(x: f64, y: f64, z: f64, turn: Vector3<f64>) -> Pose {
    Pose::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new(turn) * forward(&home()).rotation,
    )
}
