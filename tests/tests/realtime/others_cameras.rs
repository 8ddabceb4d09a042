//! `run --topics`: a simulated run in real time whose frames are others', those of `trocar cameras`
//! or of anyone.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{Intrinsics, Pose};
use tests::{alone, child_of, json, scratch, trocar};
use trocar_log::RunLog;
use trocar_topics::{CameraTopic, FrameHeader, SnapshotTopic, TopicNode};

use super::{
    CHECKPOINT, MS_NS, MonotonicClock, checked_log, expect_a_stop, expect_nothing_left, moves,
    send, sleep_ns, until,
};

/// What the policy was trained with, pixels.
const SIDE: u32 = 512;

fn topics(test: &str) -> String {
    format!("test-{}-{test}", std::process::id())
}

fn run(topics: &str, more: &[&str]) -> Command {
    let mut command = trocar();
    command
        .args(["run", "--task", "needle-lift", "--policy", CHECKPOINT])
        .args(["--topics", topics])
        .args(more)
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    command
}

/// `trocar cameras` by hand, ended with the test.
struct Cameras(Child);

impl Cameras {
    fn start(topics: &str, more: &[&str]) -> Self {
        let child = trocar()
            .args(["cameras", "--task", "needle-lift", "--topics", topics])
            .args(more)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self(child)
    }
}

impl Drop for Cameras {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// A run draws nothing itself; its arm holds when others' cameras are killed, and goes on when
/// another process shows frames in their place.
#[test]
fn others_cameras_join_and_rejoin_a_run() {
    let _turn = alone();
    let folder = scratch("others-cameras");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let name = topics("rejoin");
    let supervised = [
        "--set",
        "control.policy.restarts=1",
        "--set",
        "scene.success.hold_s=10",
        "--set",
        "scene.episode.time_limit_s=300",
    ];
    // Cameras of a scene that is configured otherwise end by what differs, as soon as they see the
    // run's.
    let mut other = Cameras::start(&name, &[]);
    let mut session = run(&name, &supervised)
        .args(["--seed", "3", "--log"])
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .spawn()
        .unwrap();
    let mut said = String::new();
    let lines = BufReader::new(other.0.stderr.take().unwrap()).lines();
    for line in lines.map_while(Result::ok) {
        said.push_str(&line);
    }
    assert_eq!(other.0.wait().unwrap().code(), Some(2), "{said}");
    assert!(
        said.contains("has another scene than these cameras"),
        "{said}"
    );
    let scene = &supervised[2..];
    let mut first = Cameras::start(&name, scene);
    until("the run is under way", || {
        assert_eq!(session.try_wait().unwrap(), None, "ended too early");
        moves(&log)
    });
    assert_eq!(child_of(session.id(), "cameras"), None, "it draws nothing");
    first.0.kill().unwrap();
    first.0.wait().unwrap();
    let heard = |words: &str| {
        let log = RunLog::open(&log);
        log.is_ok_and(|log| log.events.iter().any(|event| event.contains(words)))
    };
    until("the arm holds", || {
        heard("camera endoscope has published no frame for 2 s; the arms stop and hold")
    });
    let second = Cameras::start(&name, scene);
    until("the arm goes on", || {
        heard("the policy answers again; its hold of the arms ends")
    });
    assert!(heard("the cameras show frames again"));
    send("-INT", session.id());
    let code = session.wait().unwrap().code();
    let result = json(&result);
    assert_eq!((code, &result["reason"]), (Some(1), &"interrupted".into()));
    let whole = checked_log(&log, &result);
    assert!(whole.counts.unwrap().frames > 10);
    expect_a_stop(&whole);
    let mut second = second;
    send("-INT", second.0.id());
    assert_eq!(second.0.wait().unwrap().code(), Some(0));
    expect_nothing_left(&[session.id(), other.0.id(), first.0.id(), second.0.id()]);
}

/// A camera of one's own that goes by the run's snapshots: grey all over. Its stamps are those of
/// the arms, so that frames and arms go together.
fn grey_camera(topics: &str, side: u32, ends: &AtomicBool) -> u64 {
    let node = TopicNode::join(topics).unwrap();
    let lens = Intrinsics::from_vertical_fov(side, side, 0.9);
    let mut camera = CameraTopic::publisher(&node, "endoscope", lens.pixel_count()).unwrap();
    let scene = SnapshotTopic::subscriber(&node, "psm1").unwrap();
    let mut shown = 0;
    while !ends.load(Ordering::Acquire) {
        if let Some(snapshot) = scene.newest().unwrap() {
            assert_eq!(snapshot.task.text(), "needle-lift");
            assert_eq!((snapshot.arm_count, snapshot.has_flap), (1, 0));
            let header =
                FrameHeader::new(snapshot.stamp, snapshot.sequence, lens, &Pose::identity());
            camera
                .publish_with(&header, |colour, depth_m, instance| {
                    colour.fill(128);
                    depth_m.fill(0.1);
                    instance.fill(0);
                })
                .unwrap();
            shown += 1;
        }
        camera.keep_alive().unwrap();
        sleep_ns(5 * MS_NS);
    }
    shown
}

/// Whoever writes frames takes part: the policy answers what anyone shows it, and the log keeps
/// that.
#[test]
fn a_policy_sees_what_anyone_shows() {
    let _turn = alone();
    let folder = scratch("others-grey");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let (name, ends) = (topics("grey"), AtomicBool::new(false));
    let (shown, result) = thread::scope(|scope| {
        let camera = scope.spawn(|| grey_camera(&name, SIDE, &ends));
        let output = run(&name, &["--set", "scene.episode.time_limit_s=4"])
            .arg("--log")
            .arg(&log)
            .arg("--json")
            .arg(&result)
            .output()
            .unwrap();
        ends.store(true, Ordering::Release);
        assert_eq!(output.status.code(), Some(1), "{}", tests::stderr(&output));
        (camera.join().unwrap(), json(&result))
    });
    let log = checked_log(&log, &result);
    let frames = log.counts.unwrap().frames;
    assert!(
        frames > 10 && frames <= shown,
        "{frames} frames of {shown} in the log"
    );
    assert!(result["policy"]["queries"].as_u64() > Some(1), "{result}");
}

/// Frames of another size are refused by the camera's name before an arm is enabled.
#[test]
fn others_frames_of_another_size_are_refused_by_name() {
    let _turn = alone();
    let (name, ends) = (topics("small"), AtomicBool::new(false));
    thread::scope(|scope| {
        let camera = scope.spawn(|| grey_camera(&name, 64, &ends));
        let output = run(&name, &["--no-log"]).output().unwrap();
        ends.store(true, Ordering::Release);
        camera.join().unwrap();
        let said = tests::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        let why = format!(
            "camera endoscope on topics {name:?} shows 64 x 64 pixels, the policy was trained with 512 x 512"
        );
        assert!(said.contains(&why), "{said}");
    });
}

/// A camera that nobody shows is waited for, named, and not for ever; in lockstep nobody can show
/// any.
#[test]
fn frames_that_nobody_shows_are_named() {
    let _turn = alone();
    let (name, clock) = (topics("nobody"), MonotonicClock::new());
    let output = run(&name, &["--no-log"]).output().unwrap();
    let said = tests::stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(clock.now().seconds() > 9.0);
    for words in [
        format!("waiting for a frame of camera endoscope on topics {name:?}, for 10 s at most"),
        format!("camera endoscope has published no frame on topics {name:?} for 10 s"),
        "trocar cameras --cameras endoscope".to_owned(),
    ] {
        assert!(said.contains(&words), "{words}: {said}");
    }
    let refused = run(&name, &["--lockstep"]).output().unwrap();
    let said = tests::stderr(&refused);
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(said.contains("--topics"), "{said}");
}

/// `trocar cameras` ends on a signal, and refuses a camera or a scene that there is not.
#[test]
fn cameras_by_hand_end_on_a_signal_and_refuse_others() {
    let mut cameras = Cameras::start(&topics("signal"), &["--cameras", "multi"]);
    let mut lines = BufReader::new(cameras.0.stderr.take().unwrap()).lines();
    let mut says = |what: &str| {
        // Clocks that are slowed down are warned of first.
        let mut told = lines.by_ref().map_while(Result::ok);
        assert!(told.any(|line| line.contains(what)), "{what}");
    };
    says("cameras endoscope, wrist of needle-lift on topics");
    send("-INT", cameras.0.id());
    says("0 instants drawn");
    assert_eq!(cameras.0.wait().unwrap().code(), Some(0));
    for (more, why) in [
        (
            &["--cameras", "ear"][..],
            "--cameras ear: there is no such camera",
        ),
        (&["--needle", "N9"], "--needle N9"),
        (&["--topics", "a/b"], "cannot name a topic"),
    ] {
        let topics = topics("refused");
        let mut arguments = vec!["cameras"];
        if !more.contains(&"--topics") {
            arguments.extend(["--topics", &topics]);
        }
        let output = trocar().args(arguments).args(more).output().unwrap();
        let said = tests::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(why), "{said}");
    }
}
