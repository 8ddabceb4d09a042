//! The needle lift's expert.

use hal::TimeNs;

use super::{failures, forward, hold, run};
use crate::expert::{CHUNK_LEN, Expert, STEP_NS};
use crate::simulation::{ArmScene, SceneState};
use crate::task::needle_lift::NeedleLift;
use crate::task::{Outcome, Scene, TaskConfig};
use crate::world::Grasp;

#[test]
fn expert_lifts_the_needle() {
    let task = TaskConfig::shipped("needle-lift");
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
    let task = TaskConfig::shipped("needle-lift");
    let hash = |seed| run(&task, seed, |_, _| {}).state_hash;
    assert_eq!(hash(3), hash(3));
    assert_ne!(hash(3), hash(4));
}

#[test]
fn needle_lift_is_the_known_episode() {
    // Recorded demonstrations and trained policies rest on these bits.
    let episode = run(&TaskConfig::shipped("needle-lift"), 3, |_, _| {});
    assert!((episode.seconds - 4.72).abs() < 1e-9, "{}", episode.seconds);
    let known = (1, 0x8700_e7b2_7af6_cab7);
    assert_eq!(
        (episode.attempts, episode.state_hash),
        known,
        "{:#018x}",
        episode.state_hash
    );
}

#[test]
fn still_arm_does_not_succeed() {
    let task = TaskConfig::shipped("needle-lift");
    let hold = hold(&task);
    let episode = run(&task, 2, |_, command| *command = hold);
    assert!(
        matches!(episode.outcome, Outcome::Failure(_)),
        "{}",
        episode.outcome
    );
    assert!(episode.seconds >= task.time_limit_s);
}

#[test]
fn expert_tries_again_after_the_jaw_let_go() {
    let mut task = TaskConfig::shipped("needle-lift");
    task.time_limit_s = 25.0;
    // Whatever it wants, the jaw opens between 4.0 and 4.3 s, in the middle of the lift.
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

#[test]
fn chunk_starts_with_the_step_and_goes_on_smoothly() {
    let task = TaskConfig::shipped("needle-lift");
    let lift = NeedleLift::shipped();
    let needle_in_scene = lift.start.draw(0, &lift.needle, &lift.organ);
    let base = task.arms[0].scene_from_rcm;
    let mut scene = SceneState {
        first: ArmScene {
            tip_in_rcm: forward(&task.arms[0].joints),
            thing_in_rcm: base.inv_mul(&needle_in_scene),
            jaw: task.arms[0].jaw,
            grasp: Grasp::default(),
        },
        second: None,
        goal_in_scene: None,
    };
    let mut expert = Expert::new(&task, 0);
    let mut steps = Expert::new(&task, 0);
    let mut expected = None;
    for step in 0..60 {
        let now = TimeNs(step * STEP_NS);
        let chunk = expert.chunk(now, &scene, step + 1);
        let targets = chunk.valid_targets();
        assert_eq!(
            (targets.len(), chunk.step_ns, chunk.observed_at),
            (CHUNK_LEN, STEP_NS, now)
        );
        assert_eq!(targets[0], steps.wishes(now, &scene)[0].first);
        // With an arm that keeps up, what was foreseen is what comes.
        assert!(
            expected.is_none_or(|target| target == targets[0]),
            "step {step}"
        );
        expected = Some(targets[1]);
        scene.first.tip_in_rcm = targets[0].tip_in_rcm();
        scene.first.jaw = targets[0].jaw;
    }
}

#[test]
fn expert_lifts_every_needle() {
    for name in ["N2", "N3", "N4", "N5"] {
        let task = TaskConfig::shipped("needle-lift")
            .with_needle(name)
            .unwrap();
        let failed = failures(&task, 0..4);
        assert!(failed.is_empty(), "{name}: {failed:#?}");
    }
}

#[test]
#[ignore = "takes minutes"]
fn expert_lifts_every_needle_fifty_times() {
    let mut failed = Vec::new();
    for name in ["N1", "N2", "N3", "N4", "N5"] {
        let task = TaskConfig::shipped("needle-lift")
            .with_needle(name)
            .unwrap();
        let of_needle = failures(&task, 100..150);
        failed.extend(of_needle.iter().map(|why| format!("{name}, {why}")));
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn expert_stays_far_from_what_the_needle_stands() {
    let mut task = TaskConfig::shipped("needle-lift");
    let Scene::NeedleLift(scene) = &mut task.scene else {
        panic!("another task");
    };
    scene.success.needle_force_n_max *= 0.7;
    scene.success.needle_gain_j_max *= 0.5;
    let failed = failures(&task, 0..2);
    assert!(failed.is_empty(), "{failed:#?}");
}
