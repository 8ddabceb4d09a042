//! The block transfer's expert.

use crate::closed_loop::{needs_its_hand, recovers, repeats, succeeds};
use crate::task::TaskConfig;
use crate::task::block_transfer::BlockTransfer;

fn task() -> TaskConfig {
    TaskConfig::shipped("block-transfer")
}

#[test]
fn expert_moves_the_block() {
    succeeds(&task(), 0..8);
}

#[test]
#[ignore = "takes a minute"]
fn expert_moves_the_block_fifty_times() {
    succeeds(&task(), 100..150);
}

#[test]
fn same_seed_gives_the_same_transfer_bit_for_bit() {
    repeats(&task());
}

#[test]
fn still_arm_does_not_move_the_block() {
    needs_its_hand(&task());
}

#[test]
fn expert_takes_the_block_again_after_the_jaw_let_go() {
    // Whatever it wants, the jaw opens for a moment just after the block has left the board.
    recovers(&task(), 40.0, 5.2..5.4, 0.28);
}

#[test]
fn expert_stays_far_from_what_the_block_stands() {
    let mut task = task();
    let scene: &mut BlockTransfer = task.scene_mut().unwrap();
    scene.success.block_force_n_max *= 0.7;
    scene.success.block_gain_j_max *= 0.5;
    succeeds(&task, 0..2);
}
