//! The run log: one MCAP file, written beside the loop without slowing it, read back bit for bit.
//!
//! [`TickRecord`] is what one tick leaves behind, [`Recorder`] writes it, [`RunLog`] reads it. Joint values are Foxglove
//! protobuf, the log's own messages JSON, so that any MCAP reader understands the file.

mod camera;
mod container;
mod descriptor;
mod drain;
mod error;
mod exact;
mod header;
mod joints;
mod json;
mod messages;
mod read;
mod record;
mod recorder;
mod safety;
mod topic;
mod writer;

#[cfg(test)]
pub(crate) mod tests;

pub use error::LogError;
pub use header::{LogCounts, RunHeader, RunOutcome};
pub use read::{Loss, RunLog};
pub use record::{ArmRecord, LoggedArm, LoggedTick, TickRecord, TickTiming};
pub use recorder::{Level, LogFile, Pressure, Recorder, SideLog, TickLog};
