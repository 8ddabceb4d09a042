//! Sessions: what the command line's verbs do with an arm, a controller and a policy.
//!
//! This is the one place where the simulator, the policies and the controller meet.
//!
//! The way of a verb: the command line gives options; `setup` or `robot` reads configuration
//! (`scene_options`, `changes`), `policy_choice` and `policies` name the policy, and `plan` puts
//! both together. Then one of the loops runs: `episode` in lockstep (`run`, `eval`, `record`,
//! `environment`, `sheet`), `realtime` by the clock. `source` is whatever answers with chunks in
//! either, `summary` what is printed of it.
//!
//! `crate::rig` holds what a loop exchanges measurements and set-points with, `crate::console` what
//! pages are shown.

pub mod anatomy;
mod can_interfaces;
pub mod changes;
mod cloud_file;
pub mod demo;
pub mod drives;
mod ended;
pub mod environment;
pub mod episode;
pub mod error;
pub mod eval;
pub mod external;
pub mod import_log;
pub mod keep;
pub mod latency;
pub mod operator;
pub mod outputs;
pub mod parallel;
pub mod pictures;
pub mod plan;
pub mod policies;
mod policy_choice;
pub mod preview;
mod published;
pub mod realtime;
pub mod record;
pub mod robot;
pub mod run;
pub mod scene_options;
pub(crate) mod scene_record;
pub mod score;
pub mod segment;
pub mod segment_training;
pub mod setup;
pub mod sheet;
pub mod simulator;
mod snapshot_report;
pub mod source;
pub mod steps;
pub mod summary;
pub mod tally;
pub mod tasks;
pub mod teleop;
mod tensorboard;
pub mod training;
mod views;
mod world_report;

#[cfg(test)]
pub(crate) mod scratch;
#[cfg(test)]
mod tests;

pub use error::SessionError;
pub use plan::Plan;
pub use policy_choice::PolicyChoice;
pub use robot::{HandsView, Robot};
pub use setup::Setup;
pub use world_report::TaskState;
