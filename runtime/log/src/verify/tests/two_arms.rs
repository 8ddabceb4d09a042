//! Logs of two arms: each is checked with its own limits, and the gaps between them.

use super::limits;
use crate::tests::Scratch;
use crate::tests::two_arms::{chunk_of_arm, run_two_arms, write_two_arms};
use crate::verify::{VerifyResult, verify};
use crate::{ArmRecord, RunOutcome, TickRecord};
use trocar_control::CommandHash;

/// An honest run with one change made to its records; the hash of the commands stays the run's if
/// `as_reported`.
fn doctored(name: &str, as_reported: bool, change: impl Fn(&mut [TickRecord])) -> VerifyResult {
    let (mut records, header) = run_two_arms(900);
    let mut hash = CommandHash::new();
    for arm in records.iter().flat_map(|record| record.arms.iter()) {
        hash.add(&arm.command);
    }
    let outcome = RunOutcome {
        command_hash: format!("{:016x}", hash.value()),
        ..RunOutcome::default()
    };
    change(&mut records);
    let outcome = as_reported.then_some(&outcome);
    let file = Scratch::new(name);
    verify(&write_two_arms(
        &file,
        &records,
        &header,
        chunk_of_arm,
        outcome,
    ))
    .unwrap()
}

fn arm(record: &mut TickRecord, index: usize) -> &mut ArmRecord {
    record.arms.iter_mut().nth(index).unwrap()
}

#[test]
fn an_honest_run_of_two_arms_breaks_no_limit() {
    let result = doctored("two-honest", true, |_| {});
    assert!(result.ok, "{:?}", result.violations.first());
    assert_eq!((result.ticks, result.skipped_periods), (900, 0));
}

#[test]
fn a_jump_of_either_arm_is_caught_and_named() {
    for (index, name) in ["psm1", "psm2"].into_iter().enumerate() {
        let result = doctored(&format!("two-jump-{name}"), false, |records| {
            arm(&mut records[600], index).command.position[4] += 1e-5;
        });
        let first = &result.violations[0];
        assert_eq!(
            (first.tick, first.arm.as_str(), first.limit.as_str()),
            (600, name, "wrist_pitch.jerk")
        );
        assert!(result.violations.iter().all(|found| found.arm == name));
    }
}

#[test]
fn arms_that_come_too_near_are_caught() {
    // The second arm does what the first one does, mirrored: as if they could go through each
    // other.
    let result = doctored("two-near", false, |records| {
        for (record, k) in records[300..].iter_mut().zip(0_u32..) {
            let share = (f64::from(k) / 600.0).powi(3);
            arm(record, 1).command.position[0] -= 0.5 * share;
            arm(record, 0).command.position[0] += 0.5 * share;
        }
    });
    let between = |found: &crate::verify::Violation| {
        found.arm == "psm1+psm2" && found.limit.starts_with("between_arms.")
    };
    assert!(
        result.violations.iter().any(between),
        "{:?}",
        limits(&result)
    );
}

#[test]
fn unreported_commands_of_either_arm_are_caught() {
    for index in [0, 1] {
        let result = doctored(&format!("two-hash-{index}"), true, |records| {
            let jaw = &mut arm(&mut records[500], index).command.jaw_velocity;
            *jaw = f64::from_bits(jaw.to_bits() ^ 1);
        });
        assert_eq!(limits(&result), ["command_hash_mismatches"]);
    }
}

#[test]
fn an_arm_that_the_log_lacks_is_missed_in_every_tick() {
    let result = doctored("two-missing", false, |records| {
        for record in &mut records[890..] {
            record.arms.second = None;
        }
    });
    assert_eq!(limits(&result), ["missing_arms"; 10]);
}
