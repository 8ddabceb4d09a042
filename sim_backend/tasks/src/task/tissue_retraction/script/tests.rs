//! The tissue retraction's expert, and what hands that are not careful do with the same arm.

use hal::ArmCommand;
use nalgebra::{Translation3, Vector3};
use trocar_world::tissue::RetractionFailure;

use crate::closed_loop::{forward, inverse, needs_its_hand, recovers, repeats, run, succeeds};
use crate::task::tissue_retraction::TissueRetraction;
use crate::task::{Outcome, Reason, TaskConfig};

fn task() -> TaskConfig {
    TaskConfig::shipped("tissue-retraction")
}

#[test]
fn expert_retracts_the_flap() {
    succeeds(&task(), 0..6);
}

#[test]
#[ignore = "takes minutes"]
fn expert_retracts_the_flap_fifty_times() {
    succeeds(&task(), 100..150);
}

#[test]
fn same_seed_gives_the_same_retraction_bit_for_bit() {
    repeats(&task());
}

#[test]
fn still_arm_retracts_nothing() {
    needs_its_hand(&task());
}

#[test]
fn expert_takes_the_flap_again_after_the_jaw_let_go() {
    // Whatever it wants, the jaw opens for a moment while the flap is lifted.
    recovers(&task(), 30.0, 4.0..4.3, 0.6);
}

/// Moves the tip that `command` asks for by `way_m` in the scene.
fn push_aside(task: &TaskConfig, command: &mut ArmCommand, way_m: Vector3<f64>) {
    let base = task.arms[0].scene_from_rcm.rotation;
    let there = Translation3::from(base.inverse() * way_m) * forward(&command.position);
    command.position = inverse(&there, &command.position);
}

#[test]
fn pulling_too_hard_loses_the_episode() {
    let task = task();
    // From the middle of the lift on, the hand goes away from the attached edge as well, at 4 cm/s.
    let episode = run(&task, 1, |seconds, command| {
        let away_m = 0.04 * (seconds - 4.3).clamp(0.0, 1.0);
        push_aside(&task, command, Vector3::new(0.0, -away_m, 0.0));
    });
    assert!(
        matches!(
            episode.outcome,
            Outcome::Failure(Reason::Tissue(
                RetractionFailure::TooHard { .. } | RetractionFailure::SlippedOut
            ))
        ),
        "{} after {} s",
        episode.outcome,
        episode.seconds
    );
}

#[test]
fn a_jaw_closed_with_all_its_effort_crushes_the_flap() {
    // The hand goes where it would, but once the jaw is to close it closes as hard as it can: the
    // drive alone gives 6.2 N to 6.6 N, and the swing of the jaw adds to that.
    let episode = run(&task(), 1, |_, command| {
        if command.jaw_position < 0.2 {
            command.jaw_position = -0.3;
            command.jaw_velocity = 0.0;
        }
    });
    assert!(
        matches!(
            episode.outcome,
            Outcome::Failure(Reason::Tissue(RetractionFailure::Squeezed { force_n }))
                if force_n > 6.0
        ),
        "{} after {} s",
        episode.outcome,
        episode.seconds
    );
}

#[test]
fn expert_stays_far_from_what_the_flap_stands() {
    let mut task = task();
    let scene: &mut TissueRetraction = task.scene_mut().unwrap();
    scene.success.force_n_max *= 0.7;
    scene.success.squeeze_n_max *= 0.7;
    scene.success.ground_depth_m_max *= 0.7;
    succeeds(&task, 0..3);
}

#[test]
fn a_grasp_beside_the_mark_loses_the_episode() {
    let task = task();
    // The hand comes in 9 mm beside the mark, and keeps what it has.
    let episode = run(&task, 1, |seconds, command| {
        let aside_m = 0.009 * seconds.min(1.0);
        push_aside(&task, command, Vector3::new(-aside_m, 0.0, 0.0));
        if seconds > 3.5 {
            command.jaw_position = 0.1;
            command.jaw_velocity = 0.0;
        }
    });
    assert!(
        matches!(
            episode.outcome,
            Outcome::Failure(Reason::Tissue(RetractionFailure::BesideMark { distance_m }))
                if (0.007..0.011).contains(&distance_m)
        ),
        "{} after {} s",
        episode.outcome,
        episode.seconds
    );
}

#[test]
fn a_hand_that_flails_retracts_nothing() {
    let task = task();
    let episode = run(&task, 1, |seconds, command| {
        let swing = |rate: f64| 0.02 * (rate * seconds).sin();
        let start = task.arms[0].joints;
        command.position = start;
        push_aside(
            &task,
            command,
            Vector3::new(swing(1.3), 0.02 + swing(0.9), swing(1.7)),
        );
        command.jaw_position = 0.4 + 0.6 * (2.3 * seconds).sin();
    });
    assert!(
        matches!(episode.outcome, Outcome::Failure(_)),
        "{}",
        episode.outcome
    );
}
