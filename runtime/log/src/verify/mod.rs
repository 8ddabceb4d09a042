//! Checks a log's commands against its limits, independently of the controller: [`trocar_verify`] on what a log holds.

#[cfg(test)]
mod tests;

use hal::ArmCommand;

use trocar_verify::{CONTROL, SAFETY};
pub use trocar_verify::{Stream, VerifyError, VerifyResult, Violation, Worst, tip_in_rcm};

use crate::{Loss, RunLog};

/// Checks every command of `log`.
///
/// Joint ranges, velocity, acceleration and jerk of each axis; the speed of the tip and how fast it turns; the workspace box for
/// the control point and both finger tips; the gap between every forbidden region and shaft, wrist and both fingers; stamps
/// that rise by whole periods; ticks that the log lacks. While the drives have no torque the command must follow the measured
/// arm without velocity; they get torque at rest where the arm was measured, and lose it at rest. The gaps between two arms. The
/// commands must add up to the hash that the run reported. Every tick must have each arm of the log's `safety.toml`, in its order.
///
/// Of a log that was cut off, what is there is checked, and the result is not [`VerifyResult::ok`] whatever was found.
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
        ok: stream.violation_count() == 0 && log.cut().is_none(),
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
