//! The tissue retraction's expert.

use super::{failures, hold, run};
use crate::task::{Outcome, Reason, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::parse(&TaskConfig::source("tissue-retraction").unwrap()).unwrap()
}

#[test]
fn expert_retracts_the_flap() {
    let failed = failures(&task(), 0..6);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
#[ignore = "takes minutes"]
fn expert_retracts_the_flap_fifty_times() {
    let failed = failures(&task(), 100..150);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn same_seed_gives_the_same_retraction_bit_for_bit() {
    let task = task();
    let hash = |seed| run(&task, seed, |_, _| {}).state_hash;
    assert_eq!(hash(3), hash(3));
    assert_ne!(hash(3), hash(4));
}

#[test]
fn still_arm_retracts_nothing() {
    let task = task();
    let hold = hold(&task);
    let episode = run(&task, 2, |_, command| *command = hold);
    assert!(matches!(
        episode.outcome,
        Outcome::Failure(Reason::TimeLimit { .. })
    ));
}

#[test]
fn expert_takes_the_flap_again_after_the_jaw_let_go() {
    let mut task = task();
    task.time_limit_s = 30.0;
    // Whatever it wants, the jaw opens for a moment while the flap is lifted.
    let episode = run(&task, 1, |seconds, command| {
        if (4.0..4.3).contains(&seconds) {
            command.jaw_position = 0.6;
            command.jaw_velocity = 0.0;
        }
    });
    assert_eq!(
        episode.outcome,
        Outcome::Success,
        "{} after {} attempts",
        episode.outcome,
        episode.attempts
    );
    assert!(episode.attempts > 1);
}
