//! The needle lift's expert.

use crate::closed_loop::{failures, needs_its_hand, recovers, repeats, run, succeeds};
use crate::task::needle_lift::NeedleLift;
use crate::task::{Outcome, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::shipped("needle-lift")
}

#[test]
fn expert_lifts_the_needle() {
    let task = task();
    let mut lost = Vec::new();
    for seed in 0..10 {
        let episode = run(&task, seed, |_, _| {});
        assert!(
            episode.speed_m_s_max < 0.06,
            "seed {seed}: {} m/s",
            episode.speed_m_s_max
        );
        if episode.outcome == Outcome::Success {
            assert!(
                (3.5..9.0).contains(&episode.seconds),
                "seed {seed}: {} s",
                episode.seconds
            );
        } else {
            lost.push(format!(
                "seed {seed}: {} after {} attempts",
                episode.outcome, episode.attempts
            ));
        }
    }
    assert!(lost.len() <= 1, "{lost:#?}");
}

#[test]
fn same_seed_gives_the_same_episode_bit_for_bit() {
    repeats(&task());
}

#[test]
fn needle_lift_is_the_known_episode() {
    // Recorded demonstrations and trained policies rest on these bits.
    let episode = run(&task(), 3, |_, _| {});
    assert!((episode.seconds - 4.72).abs() < 1e-9, "{}", episode.seconds);
    let known = (1, 0xe4a2_632d_b0bd_ed17);
    assert_eq!(
        (episode.attempts, episode.state_hash),
        known,
        "{:#018x}",
        episode.state_hash
    );
}

#[test]
fn still_arm_does_not_succeed() {
    needs_its_hand(&task());
}

#[test]
fn expert_tries_again_after_the_jaw_let_go() {
    // Whatever it wants, the jaw opens between 4.0 and 4.3 s, in the middle of the lift.
    recovers(&task(), 25.0, 4.0..4.3, 0.6);
}

#[test]
fn expert_lifts_every_needle() {
    for name in ["N2", "N3", "N4", "N5"] {
        let task = task().with_needle(name).unwrap();
        succeeds(&task, 0..4);
    }
}

#[test]
#[ignore = "takes minutes"]
fn expert_lifts_every_needle_fifty_times() {
    let mut failed = Vec::new();
    for name in ["N1", "N2", "N3", "N4", "N5"] {
        let task = task().with_needle(name).unwrap();
        let of_needle = failures(&task, 100..150);
        failed.extend(of_needle.iter().map(|why| format!("{name}, {why}")));
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn expert_stays_far_from_what_the_needle_stands() {
    let mut task = task();
    let scene: &mut NeedleLift = task.scene_mut().unwrap();
    scene.success.needle_force_n_max *= 0.7;
    scene.success.needle_gain_j_max *= 0.5;
    succeeds(&task, 0..2);
}
