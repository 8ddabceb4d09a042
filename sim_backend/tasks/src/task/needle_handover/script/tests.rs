//! The needle handover's expert.

use crate::closed_loop::{needs_its_hand, recovers, repeats, succeeds};
use crate::task::TaskConfig;
use crate::task::needle_handover::NeedleHandover;

fn task() -> TaskConfig {
    TaskConfig::shipped("needle-handover")
}

#[test]
fn expert_hands_the_needle_over() {
    succeeds(&task(), 0..8);
}

#[test]
#[ignore = "takes minutes"]
fn expert_hands_the_needle_over_fifty_times() {
    succeeds(&task(), 100..150);
}

#[test]
fn same_seed_gives_the_same_handover_bit_for_bit() {
    repeats(&task());
}

#[test]
fn still_giver_hands_nothing_over() {
    needs_its_hand(&task());
}

#[test]
fn giver_fetches_the_needle_again_after_the_jaw_let_go() {
    // Whatever it wants, the giver's jaw opens for a moment while it carries the needle.
    recovers(&task(), 45.0, 4.5..4.8, 0.6);
}

#[test]
fn expert_stays_far_from_what_the_needle_stands() {
    let mut task = task();
    let scene: &mut NeedleHandover = task.scene_mut().unwrap();
    scene.success.needle_force_n_max *= 0.7;
    scene.success.needle_gain_j_max *= 0.5;
    succeeds(&task, 0..2);
}
