#![doc = include_str!("../README.md")]

mod assembly;
mod bound;
mod buses;
mod camera;
mod container;
mod contents;
mod descriptor;
mod drain;
mod error;
mod exact;
mod frames;
mod happened;
mod header;
mod item;
mod joints;
mod json;
mod level;
pub mod live;
mod messages;
mod read;
mod record;
mod recorder;
pub mod replay;
mod ring;
mod safety;
mod scene;
mod shown;
mod snapshot;
mod step;
mod sync;
mod topic;
pub mod verify;
mod writer;

#[cfg(test)]
mod tests;

pub use buses::{BusRecord, BusesRecord};
pub use drain::OnFailure;
pub use error::LogError;
pub use header::{LogCounts, RunHeader, RunMark, RunNote, RunOutcome};
pub use level::Level;
pub use read::{Loss, RunLog, read_steps};
pub use record::{ArmRecord, LoggedArm, LoggedTick, TickRecord, TickTiming};
pub use recorder::{LogFile, Pressure, Recorder, SceneLog, SideLog, TickLog, Writing};
pub use ring::pre_faulted_queue;
pub use safety::LoggedReport;
pub use scene::{CriterionRecord, FlapRecord, SceneRecord, TaskRecord};
pub use shown::{LoggedItem, read_items};
pub use snapshot::LoggedSnapshot;
pub use step::{LogEnd, Step};
