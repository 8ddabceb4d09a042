#![doc = include_str!("../README.md")]

mod arm;
mod axis;
mod boundary;
mod chain;
mod differences;
mod distance;
mod document;
mod ledger;
mod limits;
mod measured;
mod pair;
mod space;
mod stream;
mod tail;
mod tip;

#[cfg(test)]
mod tests;

use core::fmt;

use serde::Serialize;

pub use chain::tip_in_rcm;
pub use ledger::Worst;
pub use limits::{CONTROL, SAFETY};
pub use measured::MeasuredClearance;
pub use stream::Stream;

/// What the check found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VerifyResult {
    /// Whether no limit was broken, in a log that is whole: a missing part can't be checked.
    pub ok: bool,
    /// Ticks that were checked.
    pub ticks: u64,
    /// Control periods that the driver skipped; no violation.
    pub skipped_periods: u64,
    /// How many limits were broken, each counted in every tick in which it was.
    pub violation_count: u64,
    /// Every limit that was broken, in every tick in which it was; the first hundred thousand.
    pub violations: Vec<Violation>,
    /// How near the measured arms came to each boundary while they held torque.
    pub measured: Vec<MeasuredClearance>,
    /// Why the log ends before its end, if it does; the rest of the result is about what comes
    /// before.
    pub cut: Option<String>,
    /// Whether that is the log's own bound alone: what it kept is whole, and there is nothing else
    /// to check.
    pub bounded: bool,
}

/// A limit that was broken in one tick.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// The tick.
    pub tick: u64,
    /// The arm; `psm1+psm2` if the limit is between two.
    pub arm: String,
    /// The limit: `yaw.velocity`, `tip_speed`, `workspace.left_finger_tip.z_min`,
    /// `forbidden.vessel.shaft`, `between_arms.shaft.shaft`, `yaw.disabled_position`; of a safe
    /// tail `tail.yaw.velocity`. With `.again` at the end, an arm that was enabled beyond a
    /// boundary had come back and went out again. With `measured.` in front,
    /// `measured.forbidden.vessel.shaft`, the measured arm was beyond the boundary, whatever was
    /// commanded.
    pub limit: String,
    /// What was commanded.
    pub value: f64,
    /// What is allowed.
    pub bound: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            tick,
            arm,
            limit,
            value,
            bound,
        } = self;
        write!(
            f,
            "tick {tick}: {arm}: {limit} is {value}, the bound {bound}"
        )
    }
}

/// Why a log cannot be checked.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    /// A configuration text is missing.
    #[error("the log does not hold {file}, so its limits are unknown")]
    NoConfiguration {
        /// Its name.
        file: &'static str,
    },
    /// A configuration text lacks a limit.
    #[error("{file} in the log: {reason}")]
    Malformed {
        /// Its name.
        file: &'static str,
        /// What is wrong.
        reason: String,
    },
}
