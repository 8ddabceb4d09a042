//! What the policy of a robot sees, and what ends a run whose cameras fail.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{Intrinsics, JointVector, Pose};
use trocar_control::Supervision;
use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, TopicNode};

use super::super::super::channels::ThreadChannels;
use super::super::super::signals::{HoldCause, Signals};
use super::*;
use crate::rt::MonotonicClock;

const MS_NS: u64 = 1_000_000;

fn state(ms: u64, jaw: f64) -> PerArm<ArmState> {
    PerArm {
        first: ArmState::at_rest(TimeNs(ms * MS_NS), JointVector::zeros(), jaw),
        second: None,
    }
}

#[test]
fn the_arms_are_seen_where_they_were_when_the_frame_was_taken() {
    let mut past = Past::default();
    assert!(past.at(TimeNs(0)).is_none());
    for ms in 0..800_u32 {
        let states = state(u64::from(ms), f64::from(ms));
        past.add(states.first.stamp, states);
    }
    let jaw_at = |ns: u64| past.at(TimeNs(ns)).unwrap().first.jaw_position;
    assert_eq!(jaw_at(300_400_000).to_bits(), 300_f64.to_bits());
    assert_eq!(jaw_at(819_000_000).to_bits(), 799_f64.to_bits());
    // What came before those that are kept, or is to come, is not known.
    for ns in [0, 267_000_000, 820_000_000, u64::MAX] {
        assert!(past.at(TimeNs(ns)).is_none(), "{ns}");
    }
}

/// A policy of this process that is shown nothing ends the run, but not while the arms hold for
/// frames.
#[test]
fn a_policy_that_is_shown_nothing_ends_the_run() {
    let channels = ThreadChannels::new((None, None), MonotonicClock::new());
    let signals = Arc::clone(&channels.seen.signals);
    let asked = RobotOptions {
        cameras: Vec::new(),
        seconds: None,
    };
    let rules = Supervision {
        restarts: 0,
        backoff_ns: 0,
        return_ns: 0,
        frozen_ns: None,
    };
    let source = ChunkSource::noop();
    let limit_ns = ANSWER_NS_MAX + source.query_every_steps() * STEP_NS;
    let mut robot = RobotThread::new(
        channels.seen,
        Some((source, channels.chunk_in)),
        Vec::new(),
        (Vec::new(), 0),
        (&asked, (rules, |_| ())),
    );
    let mut at = |ns: u64| robot.shown_nothing(TimeNs(ns), &signals);
    assert_eq!(at(MS_NS), None);
    assert_eq!(at(MS_NS + limit_ns), None);
    let told = at(MS_NS + limit_ns + 1).unwrap();
    let unshown =
        "the policy has answered nothing for 10 s: it sees no arms and frames of one instant";
    assert_eq!(told, unshown);
    signals.hold(HoldCause::Frames);
    assert_eq!(at(2 * limit_ns), None);
    signals.go_on(HoldCause::Frames);
    assert_eq!(at(3 * limit_ns), None);
    assert!(at(3 * limit_ns + 1).is_some());
}

/// What a camera does once it has shown some frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Camera {
    Dies,
    /// It shows the same exposure again and again.
    Freezes,
    /// It stamps the same pixels anew.
    Repeats,
    /// It shows frames of another size.
    Grows,
    /// It dies, and another takes its place once the arms hold.
    Returns,
    /// It goes on.
    Lives,
}

/// Publishes a frame of `side` by `side` pixels of that `grey` that was exposed at `stamp`.
fn show(camera: &mut FramePublisher, side: u32, stamp: TimeNs, grey: u8) {
    let lens = Intrinsics::from_vertical_fov(side, side, 0.9);
    let header = FrameHeader::new(stamp, 1, lens, &Pose::identity());
    let blank = |colour: &mut [u8], depth_m: &mut [f32], instance: &mut [u8]| {
        colour.fill(grey);
        depth_m.fill(0.0);
        instance.fill(0);
    };
    camera.publish_with(&header, blank).unwrap();
}

/// How a run of `seconds` ends whose only camera, of ours, does that, and whose arms are always
/// measured; whether the arms were seen to hold for want of frames and then of an answer. A camera
/// may be gone so many `times`.
fn ended(does: Camera, seconds: f64, times: u32) -> (RobotEnd, bool) {
    let clock = MonotonicClock::new();
    let node = TopicNode::join(&format!("test-{}-{does:?}", std::process::id())).unwrap();
    let mut camera = Some(CameraTopic::publisher(&node, "scope", 64).unwrap());
    let topic = CameraTopic::subscriber(&node, "scope").unwrap();
    let channels = ThreadChannels::new((None, None), clock);
    let (mut measured, signals) = (channels.measured, Arc::clone(&channels.seen.signals));
    let asked = RobotOptions {
        cameras: Vec::new(),
        seconds: Some(seconds),
    };
    let cameras = (vec![("scope".to_owned(), topic)], 1);
    let rules = Supervision {
        restarts: times,
        backoff_ns: 0,
        return_ns: 60_000 * MS_NS,
        frozen_ns: Some(500 * MS_NS),
    };
    let robot = RobotThread::new(
        channels.seen,
        None,
        Vec::new(),
        cameras,
        (&asked, (rules, |_| ())),
    );
    let robot = robot.woken_by(node.events().unwrap());
    let ended = AtomicBool::new(false);
    thread::scope(|scope| {
        let arms = scope.spawn(|| {
            let frozen = clock.to_system(clock.now());
            let (mut was_gone, mut came_back) = (false, false);
            for tick in 0_u64.. {
                let now = clock.now();
                measured.put(state(now.0 / MS_NS, 0.0));
                let (stamp, late) = (clock.to_system(now), tick > 100);
                let [grey, ..] = tick.to_le_bytes();
                match (&mut camera, does) {
                    (Some(_), Camera::Dies) if late => camera = None,
                    (Some(_), Camera::Returns) if late && !was_gone => {
                        camera = None;
                        was_gone = true;
                    }
                    (Some(camera), Camera::Freezes) => show(camera, 4, frozen, grey),
                    (Some(camera), Camera::Repeats) => show(camera, 4, stamp, 96),
                    (Some(camera), Camera::Grows) => {
                        show(camera, if late { 8 } else { 4 }, stamp, grey)
                    }
                    (Some(camera), Camera::Dies | Camera::Returns | Camera::Lives) => {
                        show(camera, 4, stamp, grey);
                    }
                    (None, Camera::Returns) if signals.lacks(HoldCause::Frames) => {
                        camera = Some(CameraTopic::publisher(&node, "scope", 64).unwrap());
                    }
                    (None, _) => {}
                }
                if was_gone && signals.lacks(HoldCause::Answers) {
                    came_back = true;
                    signals.end_run();
                }
                if signals.done() || ended.load(Ordering::Acquire) {
                    break;
                }
                rt::sleep_ns(2 * MS_NS);
            }
            // The control thread stops once the arms rest.
            drop(super::super::super::signals::StopsAll(&signals));
            came_back
        });
        let end = robot.run().unwrap();
        ended.store(true, Ordering::Release);
        (end, arms.join().unwrap())
    })
}

/// Nobody waits for longer than the 2 s that a camera may be silent.
#[test]
fn cameras_that_fail_end_the_run_by_name() {
    let silent = "camera scope has published no frame for 2 s";
    let repeated = "camera scope has shown the very same pixels for 0.5 s";
    let resized = "camera scope shows other frames than at first: 8 x 8 pixels";
    let cases = [
        (Camera::Dies, silent),
        (Camera::Freezes, silent),
        (Camera::Repeats, repeated),
        (Camera::Grows, resized),
    ];
    let clock = MonotonicClock::new();
    thread::scope(|scope| {
        let cases =
            cases.map(|(does, said)| scope.spawn(move || (does, said, ended(does, 60.0, 0).0)));
        for case in cases {
            let (does, said, end) = case.join().unwrap();
            assert_eq!(end.ended_by.as_deref(), Some(said), "{does:?}");
            assert!(!end.as_asked, "{does:?}");
        }
    });
    assert!(clock.now().0 < 60_000 * MS_NS);
    let (end, _) = ended(Camera::Lives, 0.5, 0);
    assert_eq!(end.ended_by.as_deref(), Some("the 0.5 s are over"));
    assert!(end.as_asked);
}

/// With restarts the arms hold while a camera is gone, and then until an answer comes to what it
/// shows again.
#[test]
fn a_camera_may_come_back() {
    let (end, came_back) = ended(Camera::Returns, 600.0, 1);
    assert!(came_back);
    assert_eq!(end.ended_by, None);
    // Once more than that often is too often.
    let mut sight = CameraMonitor::new(vec!["scope".to_owned()], (Supervision::default(), |_| ()));
    let signals = Signals::default();
    assert!(sight.judge(TimeNs(5000 * MS_NS), &signals).is_some());
}
