//! The controller of one arm: pure, bounded and bit-reproducible.
//!
//! [`controller`] is the tick. On its way a chunk passes [`gate`], [`aggregate`], [`tracking`] (inverse kinematics),
//! [`filter`] with its [`rows`] and [`viability`], [`smoother`], and [`guard`] with its [`stop`]. [`mode`] says whether the arm
//! may move at all, [`report`] what goes in and comes out, [`config`] what all hang on, and [`hash`] makes one number of all
//! commands.

pub mod aggregate;
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
pub mod report;
pub mod region;
pub mod rows;
mod schema;
pub mod smoother;
pub mod stop;
pub mod tracking;
pub mod viability;

#[cfg(test)]
pub(crate) mod random;
#[cfg(test)]
mod tests;

pub use config::ControlConfig;
pub use controller::Controller;
pub use gate::Verdict;
pub use hash::{CommandHash, InputHash};
pub use mode::{Mode, OperatingState, OperatorEvent};
pub use report::{Fault, QpOutcome, TickInput, TickOutput, TickReport};
