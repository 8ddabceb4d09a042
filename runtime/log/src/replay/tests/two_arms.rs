//! Replays of two arms: both are recomputed, and a bit of either shows.

use hal::Chunk;

use super::flip;
use crate::replay::{Difference, ReplayResult, replay};
use crate::tests::Scratch;
use crate::tests::two_arms::{chunk_of_arm, run_two_arms, write_two_arms};
use crate::{ArmRecord, TickRecord};

const TICKS: u64 = 900;

/// An honest run, with a change made to what the log says: the hash over the inputs stays the
/// run's.
fn changed(
    name: &str,
    change: impl Fn(&mut [TickRecord]),
    given: impl Fn(usize, u64) -> Chunk,
) -> ReplayResult {
    let (mut records, header) = run_two_arms(TICKS);
    let file = Scratch::new(name);
    let honest = write_two_arms(&file, &records, &header, chunk_of_arm, None);
    change(&mut records);
    let mut log = write_two_arms(&file, &records, &header, given, None);
    log.input_hash = honest.input_hash;
    replay(&log).unwrap()
}

fn arm(record: &mut TickRecord, index: usize) -> &mut ArmRecord {
    record.arms.iter_mut().nth(index).unwrap()
}

fn found(result: ReplayResult) -> Difference {
    assert!(!result.identical && !result.inputs_checked || result.ticks == TICKS);
    result.first_difference.unwrap()
}

#[test]
fn a_replay_recomputes_both_arms() {
    let result = changed("two-replay", |_| {}, chunk_of_arm);
    assert!(result.identical && result.inputs_checked, "{result:?}");
    assert_eq!((result.ticks, result.cut), (TICKS, None));
    let second_opinion = result.second_opinion;
    assert!(second_opinion.problems > 0, "they never met");
    assert_eq!(second_opinion.unsolved, 0);
    assert!(second_opinion.largest_difference < 1e-5);
}

#[test]
fn one_flipped_bit_in_a_command_of_either_arm_shows() {
    for (index, what) in ["psm1.velocity.jaw", "psm2.velocity.jaw"]
        .into_iter()
        .enumerate()
    {
        let result = changed(
            &format!("two-command-{index}"),
            |records| flip(&mut arm(&mut records[300], index).command.jaw_velocity),
            chunk_of_arm,
        );
        let difference = found(result);
        assert_eq!((difference.tick, difference.what.as_str()), (300, what));
    }
}

#[test]
fn a_flipped_bit_in_an_input_of_either_arm_shows() {
    for index in [0, 1] {
        let result = changed(
            &format!("two-measured-{index}"),
            |records| {
                let measured = &mut arm(&mut records[700], index).measured;
                flip(&mut measured.as_mut().unwrap().effort[3]);
            },
            chunk_of_arm,
        );
        assert_eq!(found(result).what, "inputs");
        let result = changed(
            &format!("two-chunk-{index}"),
            |_| {},
            |arm, sequence| {
                let mut chunk = chunk_of_arm(arm, sequence);
                if (arm, sequence) == (index, 2) {
                    flip(&mut chunk.targets[49].jaw);
                }
                chunk
            },
        );
        assert_eq!(found(result).what, "inputs");
    }
}

#[test]
fn an_operator_of_one_arm_only_shows() {
    let result = changed(
        "two-operator",
        |records| {
            let enabled = arm(&mut records[2], 1).operator.take();
            assert!(enabled.is_some());
        },
        chunk_of_arm,
    );
    assert_eq!(found(result).what, "psm2.enabled");
}

#[test]
fn a_chunk_counts_as_the_arms_that_was_given_it() {
    let (records, header) = run_two_arms(100);
    let file = Scratch::new("two-other-arm");
    let hash = |owner: usize| {
        let mut records = records.clone();
        for (index, told) in records[50].arms.iter_mut().enumerate() {
            told.chunk_sequence = (index == owner).then_some(2);
        }
        let same = |_, sequence| chunk_of_arm(0, sequence);
        write_two_arms(&file, &records, &header, same, None).input_hash
    };
    assert_ne!(hash(0), hash(1));
}

#[test]
fn a_log_that_lacks_an_arm_is_not_the_run() {
    let result = changed(
        "two-lacks-one",
        |records| {
            for record in records {
                record.arms.second = None;
            }
        },
        chunk_of_arm,
    );
    let difference = found(result);
    assert_eq!(difference.to_string(), "tick 0: arms: logged 1, computed 2");
}
