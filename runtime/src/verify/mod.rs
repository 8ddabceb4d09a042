//! Checks a log's commands against its limits, independently of the controller.
//!
//! Nothing here is shared with the controller: limits are looked up in the logged texts, forward kinematics is the
//! product of the arm's table, distances are found by search, derivatives are differences of the setpoints as they were
//! sent.
//!
//! [`verify()`] checks a log, [`Stream`] commands as they come and the safe tails that travel with them.

mod arm;
mod axis;
mod boundary;
mod chain;
mod differences;
mod distance;
mod document;
mod ledger;
mod limits;
mod pair;
mod space;
mod stream;
mod tail;
mod tip;

#[cfg(test)]
mod tests;

use core::fmt;

use hal::ArmCommand;
use serde::Serialize;

pub use chain::tip_in_rcm;
pub use ledger::Worst;
pub use stream::Stream;

use crate::log::{Loss, RunLog};
use limits::{CONTROL, SAFETY};

/// What the check found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VerifyResult {
    /// Whether no limit was broken.
    pub ok: bool,
    /// Ticks that were checked.
    pub ticks: u64,
    /// Control periods that the driver skipped; no violation.
    pub skipped_periods: u64,
    /// How many limits were broken, each counted in every tick in which it was.
    pub violation_count: u64,
    /// Every limit that was broken, in every tick in which it was; the first hundred thousand.
    pub violations: Vec<Violation>,
    /// Why the log ends before its end, if it does; the rest of the result is about what comes before.
    pub cut: Option<String>,
}

/// A limit that was broken in one tick.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// The tick.
    pub tick: u64,
    /// The arm; `psm1+psm2` if the limit is between two.
    pub arm: String,
    /// The limit: `yaw.velocity`, `tip_speed`, `workspace.left_finger_tip.z_min`, `forbidden.vessel.shaft`,
    /// `between_arms.shaft.shaft`, `yaw.disabled_position`; of a safe tail `tail.yaw.velocity`. With `.again` at the end, an arm
    /// that was enabled beyond a boundary had come back and went out again.
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

/// Checks every command of `log`.
///
/// Joint ranges, velocity, acceleration and jerk of each axis; the speed of the tip and how fast it turns; the workspace box for
/// the control point and both finger tips; the gap between every forbidden region and shaft, wrist and both fingers; stamps
/// that rise by whole periods; ticks that the log lacks. While the drives have no torque the command must follow the measured
/// arm without velocity; they get torque at rest where the arm was measured, and lose it at rest. The gaps between two arms. The
/// commands must add up to the hash that the run reported. Every tick must have each arm of the log's `safety.toml`, in its order.
///
/// # Errors
/// [`VerifyError`] when the log does not say what the limits are.
pub fn verify(log: &RunLog) -> Result<VerifyResult, VerifyError> {
    let text = |file| log.text(file).ok_or(VerifyError::NoConfiguration { file });
    let mut stream = Stream::new(text(CONTROL)?, text(SAFETY)?)?;
    let mut ticks = 0;
    let mut hash = FNV_OFFSET;
    let gap_before = |position: usize| {
        log.losses.iter().find_map(|loss| match *loss {
            Loss::Ticks {
                position: at,
                count,
            } if at == position => Some(count),
            Loss::Ticks { .. } | Loss::Chunk { .. } => None,
        })
    };
    for (position, (tick, _)) in log.ticks().enumerate() {
        if let Some(count) = gap_before(position) {
            stream.missing(tick.tick, count);
        }
        let told = tick.arms.as_ref().map(|arm| (&arm.command, &arm.measured));
        match told.second {
            None => stream.tick(tick.tick, &[told.first]),
            Some(second) => stream.tick(tick.tick, &[told.first, second]),
        }
        stream.expect_arms(told.count());
        for (command, _) in told.iter() {
            add_to_hash(&mut hash, command);
        }
        ticks += 1;
    }
    if let Some(count) = gap_before(log.tick_count()) {
        stream.missing(
            log.ticks().last().map_or(0, |(tick, _)| tick.tick + 1),
            count,
        );
    }
    let reported = log.outcome.as_ref().map(|outcome| &outcome.command_hash);
    if log.losses.is_empty() && reported.is_some_and(|reported| *reported != format!("{hash:016x}"))
    {
        stream.other_hash();
    }
    Ok(VerifyResult {
        ok: stream.violation_count() == 0,
        ticks,
        skipped_periods: stream.skipped_periods(),
        violation_count: stream.violation_count(),
        violations: stream.into_violations(),
        cut: log.cut().map(str::to_owned),
    })
}

/// FNV-1a's start and factor, 64 bits.
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Takes one command into the hash that a run reports, in the order that the run documents.
fn add_to_hash(hash: &mut u64, command: &ArmCommand) {
    let numbers = command.position.iter().chain(command.velocity.iter());
    let jaw = [&command.jaw_position, &command.jaw_velocity];
    let words = [command.stamp.0]
        .into_iter()
        .chain(numbers.chain(jaw).map(|number| number.to_bits()))
        .chain([u64::from(command.enabled)]);
    for byte in words.flat_map(u64::to_le_bytes) {
        *hash = (*hash ^ u64::from(byte)).wrapping_mul(FNV_PRIME);
    }
}
