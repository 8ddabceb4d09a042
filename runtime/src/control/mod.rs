//! The controller of one arm, or of two that share a scene: pure, bounded and bit-reproducible.
//!
//! [`controller`] is the tick, [`any`] one of as many arms as there are. On its way a chunk passes [`gate`], [`aggregate`], [`tracking`] (inverse kinematics),
//! [`filter`] with its [`rows`], [`viability`] and solver ([`active_set`]), [`smoother`], and [`guard`] with its [`stop`]. Both of
//! these know where the instrument is ([`instrument`]) and how far from what ([`region`], [`distance`]). [`mode`] says whether
//! an arm may move at all, [`report`] what goes in and comes out, [`config`] what all hang on, and [`hash`] makes one number of
//! all commands.

pub mod active_set;
pub mod aggregate;
pub mod any;
mod arm_control;
pub mod config;
pub mod controller;
pub mod distance;
pub mod filter;
pub mod gate;
pub mod guard;
pub mod hash;
pub mod instrument;
pub mod mode;
pub mod motion;
pub mod region;
pub mod report;
pub mod rows;
mod schema;
pub mod second_opinion;
pub mod smoother;
pub mod stop;
pub mod tracking;
pub mod viability;

#[cfg(test)]
pub(crate) mod random;
#[cfg(test)]
pub(crate) mod sabotage;
#[cfg(test)]
mod tests;

pub use any::AnyController;
pub use config::ControlConfig;
pub use controller::{Controller, ControllerError};
pub use gate::Verdict;
pub use hash::{CommandHash, InputHash};
pub use mode::{Mode, OperatingState, OperatorEvent};
pub use report::{Fault, QpOutcome, TickInput, TickOutput, TickReport};
