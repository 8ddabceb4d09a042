//! A backend's side of the safe tail. Hot path: bounded, no allocation, no I/O, no lock.

use super::SafeTail;
use crate::{ArmCommand, TimeNs};

/// Plays the tail for a backend whose controller sends no more commands.
///
/// The backend asks once a period what to do. It reads no clock: a period without a new command is
/// a period of the stop.
#[derive(Clone, Copy, Debug)]
pub struct TailPlayer {
    period_ns: u64,
    newest: Option<SafeTail>,
    /// What the newest setpoint is for, be it the controller's or the tail's.
    stamp: TimeNs,
    written: bool,
}

impl TailPlayer {
    /// A player for a backend that moves on every `period_ns`. It plays nothing before the first
    /// command.
    #[must_use]
    pub const fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            newest: None,
            stamp: TimeNs(0),
            written: false,
        }
    }

    /// Takes note of a command that the controller gave, with its tail.
    pub fn write(&mut self, command: &ArmCommand, tail: &SafeTail) {
        self.newest = Some(*tail);
        self.stamp = command.stamp;
        self.written = true;
    }

    /// What replaces the setpoint in the period that begins: nothing if the controller has given
    /// one since the last call or never gave one, otherwise the tail's next point, which at its end
    /// is the arm at rest.
    pub fn next_period(&mut self) -> Option<ArmCommand> {
        let tail = self.newest.as_ref()?;
        if core::mem::take(&mut self.written) {
            return None;
        }
        self.stamp = TimeNs(self.stamp.0.saturating_add(self.period_ns));
        Some(tail.command_at(self.stamp))
    }
}
