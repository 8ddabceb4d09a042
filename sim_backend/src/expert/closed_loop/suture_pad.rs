//! The suture pad's expert.

use super::{failures, hold, run};
use crate::task::{Outcome, Scene, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::shipped("suture-pad")
}

#[test]
fn expert_drives_the_needle_through() {
    let failed = failures(&task(), 0..8);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
#[ignore = "takes minutes"]
fn expert_drives_the_needle_through_fifty_times() {
    let failed = failures(&task(), 100..150);
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn same_seed_gives_the_same_drive_bit_for_bit() {
    let task = task();
    let hash = |seed| run(&task, seed, |_, _| {}).state_hash;
    assert_eq!(hash(3), hash(3));
    assert_ne!(hash(3), hash(4));
}

#[test]
fn still_arm_drives_nothing() {
    let task = task();
    let hold = hold(&task);
    let episode = run(&task, 2, |_, command| *command = hold);
    assert!(matches!(episode.outcome, Outcome::Failure(_)));
    assert!(episode.seconds >= task.time_limit_s);
}

#[test]
fn expert_takes_the_needle_again_after_the_jaw_let_go() {
    let mut task = task();
    task.time_limit_s = 40.0;
    // Whatever it wants, the jaw opens for a moment while the needle is carried.
    let episode = run(&task, 1, |seconds, command| {
        if (4.5..4.8).contains(&seconds) {
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

#[test]
fn expert_stays_far_from_what_the_needle_stands() {
    let mut task = task();
    let Scene::SuturePad(scene) = &mut task.scene else {
        panic!("another task");
    };
    scene.success.needle_force_n_max *= 0.7;
    scene.success.needle_gain_j_max *= 0.5;
    let failed = failures(&task, 0..2);
    assert!(failed.is_empty(), "{failed:#?}");
}
