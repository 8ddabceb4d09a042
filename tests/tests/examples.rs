//! The examples of library use do what they say.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each example has a main of its own"
)]
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "examples/in_lockstep.rs"]
mod in_lockstep;
#[path = "../../runtime/control/examples/own_arm.rs"]
mod own_arm;
#[path = "../../runtime/app/examples/own_camera.rs"]
mod own_camera;
#[path = "../../runtime/app/examples/own_policy.rs"]
mod own_policy;
#[path = "../../runtime/app/examples/own_robot.rs"]
mod own_robot;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use tests::{repository, scratch};
use trocar::rt::{self, MonotonicClock};
use trocar::session::SessionError;
use trocar::session::run::RunResult;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{LoggedItem, RunLog, read_items};
use trocar_topics::{CameraTopic, TopicNode};

/// An own robot runs in real time and its log replays and verifies.
#[test]
fn own_robot_runs_and_its_log_verifies() {
    let log = scratch("own-robot").join("run.mcap");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let result = own_robot::run(&safety, log.clone()).unwrap();
    let summary = result.summary;
    assert!(result.ok, "{summary:?}");
    assert_eq!(
        (summary.reason.as_str(), summary.success),
        ("the 2 s are over", None)
    );
    assert!(summary.policy.queries > 5, "{summary:?}");
    let log = RunLog::open(&log).unwrap();
    assert!(replay(&log).unwrap().identical);
    assert!(verify(&log).unwrap().ok);
    // The tip has gone 1 cm to the side, give or take the lag.
    let place = |tick: Option<&trocar_log::LoggedTick>| {
        let measured = tick.unwrap().arms.first.measured.unwrap();
        trocar_control::kinematics::forward(&measured.position)
            .translation
            .vector
    };
    let ticks: Vec<_> = log.ticks().map(|(tick, _)| tick).collect();
    let way = place(ticks.last().copied()) - place(ticks.first().copied());
    assert!((way.norm() - 0.01).abs() < 5e-4, "{way}");
}

#[test]
fn a_rig_of_another_number_of_arms_is_refused() {
    let log = scratch("own-robot-arms").join("run.mcap");
    let safety = repository().join("config/tasks/needle-handover/safety.toml");
    let refused = own_robot::run(&safety, log).unwrap_err().to_string();
    assert!(refused.contains("the rig has 1 arms"), "{refused}");
}

/// An own robot driven by the committed policy for needle lift, whose endoscope an own camera shows
/// with `side` by `side` pixels, and its log.
fn driven_by_sight(side: u32) -> (Result<RunResult, SessionError>, PathBuf) {
    let log = scratch(&format!("own-robot-sees-{side}")).join("run.mcap");
    let topics = format!("own-robot-{side}-{}", std::process::id());
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let policy = repository().join("config/policies/needle-lift/act-compact");
    let ended = AtomicBool::new(false);
    let result = thread::scope(|scope| {
        let camera = scope.spawn(|| {
            own_camera::run(&topics, "endoscope", side, |_| {
                ended.load(Ordering::Acquire)
            })
        });
        let result = own_robot::run_trained(&safety, &policy, &topics, log.clone());
        ended.store(true, Ordering::Release);
        camera.join().unwrap().unwrap();
        result
    });
    (result, log)
}

/// The log has what the policy saw.
#[test]
fn a_committed_policy_drives_an_own_robot_by_an_own_camera() {
    let (result, log) = driven_by_sight(512);
    let result = result.unwrap();
    let summary = result.summary;
    assert!(result.ok, "{summary:?}");
    assert_eq!(summary.reason, "the 2 s are over");
    assert!(summary.policy.queries > 0, "{summary:?}");
    let mut frames = 0;
    read_items(&log, |item| {
        if let LoggedItem::Image { camera, .. } = item {
            assert_eq!(camera, "endoscope");
            frames += 1;
        }
    })
    .unwrap();
    assert!(frames > 5, "{frames}");
    let log = RunLog::open(&log).unwrap();
    assert!(replay(&log).unwrap().identical);
    assert!(verify(&log).unwrap().ok);
}

#[test]
fn an_own_camera_of_another_size_is_refused() {
    let refused = driven_by_sight(256).0.unwrap_err().to_string();
    assert!(
        refused.contains("camera endoscope on topics")
            && refused.contains("shows 256 x 256 pixels, the policy was trained with 512 x 512"),
        "{refused}"
    );
}

/// Frames of the example's camera as a run sees them: of the size that it says, stamped with the
/// time of now, each newer than the one before, and another picture.
#[test]
fn an_own_cameras_frames_are_seen_as_they_come() {
    let topics = format!("own-camera-{}", std::process::id());
    let node = TopicNode::join(&topics).unwrap();
    let mut seen = CameraTopic::subscriber(&node, "endoscope").unwrap();
    let clock = MonotonicClock::new();
    let camera =
        thread::spawn(move || own_camera::run(&topics, "endoscope", 256, |shown| shown == 100));
    let mut frames: Vec<(u64, Vec<u8>)> = Vec::new();
    while frames.len() < 5 {
        assert!(clock.now().seconds() < 30.0, "{} frames", frames.len());
        if let Some(view) = seen.newest().unwrap() {
            let header = *view.header();
            let now = clock.to_system(clock.now());
            assert!(header.stamp <= now && now.since(header.stamp) < 30_000_000_000);
            assert_eq!(
                (header.intrinsics.width, header.intrinsics.height),
                (256, 256)
            );
            assert_eq!(
                (view.colour().len(), view.depth_m().len()),
                (3 << 16, 1 << 16)
            );
            frames.push((header.sequence, view.colour().to_vec()));
        }
        rt::sleep_ns(1_000_000);
    }
    for pair in frames.windows(2) {
        assert!(pair[0].0 < pair[1].0);
        assert_ne!(pair[0].1, pair[1].1);
    }
    assert_eq!(camera.join().unwrap().unwrap(), 100);
}
