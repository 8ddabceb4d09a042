//! Checks a log's commands against its limits, independently of the controller: [`trocar_verify`]
//! on what a log holds.

#[cfg(test)]
mod tests;

use std::path::Path;

use hal::ArmCommand;

use trocar_verify::{CONTROL, SAFETY};
pub use trocar_verify::{
    MeasuredClearance, Stream, VerifyError, VerifyResult, Violation, Worst, tip_in_rcm,
};

use crate::{LogEnd, LogError, RunHeader, RunLog, Step, read_steps};

/// Checks every command of `log`.
///
/// Joint ranges, velocity, acceleration and jerk of each axis; the rates that travel with a
/// setpoint; the speed of the tip and how fast it turns; the workspace box for the control point
/// and both finger tips; the gap between every forbidden region and shaft, wrist and both fingers,
/// both as commanded and as measured; stamps that rise by whole periods and are the ticks' own;
/// ticks that the log lacks. While the drives have no torque the command must follow the measured
/// arm without velocity; they get torque at rest where the arm was measured, and lose it at rest.
/// The gaps between two arms. The commands must add up to the hash that the run reported. Every
/// tick must have each arm of the log's `safety.toml`, in its order. Nothing in the log may have
/// been changed since the run.
///
/// Of a log that was cut off, what is there is checked, and the result is not [`VerifyResult::ok`]
/// whatever was found.
///
/// # Errors
/// [`VerifyError`] when the log does not say what the limits are.
pub fn verify(log: &RunLog) -> Result<VerifyResult, VerifyError> {
    let mut checker = Checker::new(&log.header)?;
    log.steps().for_each(|step| checker.step(&step));
    Ok(checker.finish(&log.end()))
}

/// Checks the log at `path` as [`verify`] does, without ever holding more than a tick of it.
///
/// # Errors
/// [`LogError`] when it is no log or was damaged, [`VerifyError`] when it does not say what the
/// limits are.
pub fn verify_file<E: From<LogError> + From<VerifyError>>(path: &Path) -> Result<VerifyResult, E> {
    let mut checker = None;
    let (header, end) = read_steps(path, |header, step| -> Result<(), E> {
        let checker = match &mut checker {
            Some(checker) => checker,
            None => checker.insert(Checker::new(header)?),
        };
        checker.step(step);
        Ok(())
    })?;
    let checker = match checker {
        Some(checker) => checker,
        None => Checker::new(&header)?,
    };
    Ok(checker.finish(&end))
}

/// A check under way.
struct Checker {
    stream: Stream,
    ticks: u64,
    /// FNV-1a over the commands as [`trocar_control::CommandHash`] documents it, computed here once
    /// more.
    hash: u64,
    /// The tick after the newest.
    next_tick: u64,
    /// Nothing is missing up to now: only then must the hash be the reported one.
    complete: bool,
}

impl Checker {
    fn new(header: &RunHeader) -> Result<Self, VerifyError> {
        let text = |file| {
            header
                .text(file)
                .ok_or(VerifyError::NoConfiguration { file })
        };
        let mut stream = Stream::new(text(CONTROL)?, text(SAFETY)?)?;
        let complete = header.left_out == 0;
        if !complete {
            stream.resume();
        }
        Ok(Self {
            stream,
            ticks: 0,
            hash: FNV_OFFSET,
            next_tick: 0,
            complete,
        })
    }

    fn step(&mut self, step: &Step<'_>) {
        let (tick, stream) = (step.tick, &mut self.stream);
        if step.dropped_before > 0 {
            stream.missing(tick.tick, step.dropped_before);
        }
        self.complete &= step.dropped_before == 0 && !step.chunk_dropped;
        let commanded = tick.arms.as_ref().map(|arm| (&arm.command, &arm.measured));
        match commanded.second {
            None => stream.tick(tick.tick, &[commanded.first]),
            Some(second) => stream.tick(tick.tick, &[commanded.first, second]),
        }
        stream.clock(tick.now);
        stream.expect_arms(commanded.count());
        for (command, _) in commanded.iter() {
            add_to_hash(&mut self.hash, command);
        }
        self.ticks += 1;
        self.next_tick = tick.tick.saturating_add(1);
    }

    fn finish(mut self, end: &LogEnd) -> VerifyResult {
        let stream = &mut self.stream;
        if end.dropped_at_end > 0 {
            stream.missing(self.next_tick, end.dropped_at_end);
            self.complete = false;
        }
        let hash = format!("{:016x}", self.hash);
        let reported = end.outcome.as_ref().map(|outcome| &outcome.command_hash);
        if self.complete && reported.is_some_and(|reported| *reported != hash) {
            stream.other_hash();
        }
        if end.altered {
            stream.other_contents();
        }
        VerifyResult {
            ok: stream.violation_count() == 0 && end.cut.is_none(),
            ticks: self.ticks,
            skipped_periods: stream.skipped_periods(),
            violation_count: stream.violation_count(),
            measured: stream.measured(),
            cut: end.cut.clone(),
            bounded: end.bounded,
            violations: self.stream.into_violations(),
        }
    }
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
