#![doc = include_str!("../README.md")]

pub mod active_set;
pub mod aggregate;
pub mod any;
mod arm_control;
pub mod config;
pub mod controller;
pub mod deviation;
pub mod distance;
pub mod filter;
pub mod gate;
pub mod guard;
pub mod hash;
pub mod instrument;
pub mod kinematics;
pub mod mode;
pub mod motion;
pub mod region;
pub mod report;
pub mod rows;
mod schema;
#[cfg(any(test, feature = "second-opinion"))]
pub mod second_opinion;
pub mod smoother;
pub mod snapshot;
pub mod stop;
pub mod tracking;
pub mod viability;

#[cfg(test)]
pub(crate) mod sabotage;
#[cfg(test)]
mod tests;

pub use any::AnyController;
pub use config::{ControlConfig, Supervision};
pub use controller::{Controller, ControllerError};
pub use deviation::Deviation;
pub use gate::GateDecision;
pub use guard::{MeasuredClearance, beyond};
pub use hash::{CommandHash, InputHash};
pub use mode::{Mode, OperatingState, OperatorEvent};
pub use report::{Fault, QpOutcome, TickInput, TickOutput, TickReport};
pub use snapshot::{HeldChunk, Snapshot, SnapshotError};
