//! The suture pad's expert.

use crate::closed_loop::{needs_its_hand, recovers, repeats, succeeds};
use crate::task::TaskConfig;
use crate::task::suture_pad::SuturePad;

fn task() -> TaskConfig {
    TaskConfig::shipped("suture-pad")
}

#[test]
fn expert_drives_the_needle_through() {
    succeeds(&task(), 0..8);
}

#[test]
#[ignore = "takes minutes"]
fn expert_drives_the_needle_through_fifty_times() {
    succeeds(&task(), 100..150);
}

#[test]
fn same_seed_gives_the_same_drive_bit_for_bit() {
    repeats(&task());
}

#[test]
fn still_arm_drives_nothing() {
    needs_its_hand(&task());
}

#[test]
fn expert_takes_the_needle_again_after_the_jaw_let_go() {
    // Whatever it wants, the jaw opens for a moment while the needle is carried.
    recovers(&task(), 40.0, 4.5..4.8, 0.6);
}

#[test]
fn expert_stays_far_from_what_the_needle_stands() {
    let mut task = task();
    let scene: &mut SuturePad = task.scene_mut().unwrap();
    scene.success.needle_force_n_max *= 0.7;
    scene.success.needle_gain_j_max *= 0.5;
    succeeds(&task, 0..2);
}
