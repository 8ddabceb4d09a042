//! CiA 402, drives and motion control: the power state machine, its two words, and the modes of
//! operation.

pub mod mode;
pub mod power;
pub mod word;

pub use mode::Mode;
pub use power::{Command, Event, PowerState};
pub use word::{Control, ControlView, Status, StatusView};

#[cfg(test)]
mod tests;
