//! A robot on CAN whose policy's process is killed and comes back, whose camera's process is
//! killed, and whose machine's clock is set.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use hal::{Intrinsics, Pose, TICK_NS, TimeNs};
use serde_json::Value;
use tests::{repository, scratch};
use trocar::rt::{MonotonicClock, Periodic, sleep_ns};
use trocar_control::OperatorEvent;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{LoggedItem, RunLog, read_items};
use trocar_topics::{CameraTopic, FrameHeader, TopicNode};

use super::matrix::{Taken, row};
use super::pair::{Process, TOPICS, pass_ms};
use super::peer::alone;
use super::performer::{Asks, Performer};

const CAMERA: &str = "scope";

/// Swings the tip to and fro, looking through the camera, until it is killed.
#[test]
fn plays_a_policy() {
    let Ok(topics) = env::var(TOPICS) else {
        return;
    };
    let camera = Some(CAMERA);
    let _performer = Performer::asking(
        &topics,
        Asks {
            camera,
            ..Asks::usual()
        },
    );
    loop {
        sleep_ns(1000 * TICK_NS);
    }
}

/// Shows small grey frames, one every 40 ms, until it is killed.
#[test]
fn plays_a_camera() {
    let Ok(topics) = env::var(TOPICS) else {
        return;
    };
    let node = TopicNode::join(&topics).unwrap();
    let lens = Intrinsics::from_vertical_fov(8, 8, 0.9);
    let mut camera = CameraTopic::publisher(&node, CAMERA, lens.pixel_count()).unwrap();
    let clock = MonotonicClock::new();
    let mut periodic = Periodic::new(clock, clock.now(), 40 * TICK_NS);
    for sequence in 0.. {
        let exposed = clock.to_system(clock.now());
        let header = FrameHeader::new(exposed, sequence, lens, &Pose::identity());
        let grey = |colour: &mut [u8], depth_m: &mut [f32], instance: &mut [u8]| {
            colour.fill(96);
            depth_m.fill(0.1);
            instance.fill(0);
        };
        camera.publish_with(&header, grey).unwrap();
        periodic.wait();
    }
}

/// Whether this is a kernel inside another, whose clock may be set. Another machine's is left
/// alone.
fn has_a_clock_of_its_own() -> bool {
    let processors = fs::read_to_string("/proc/cpuinfo").unwrap();
    processors.contains("User Mode Linux")
}

/// Sets the system's clock ahead by so many seconds, or back, if it may be set.
fn set_the_clock(by_s: f64) {
    if has_a_clock_of_its_own() {
        let date = format!("now {by_s:+} seconds");
        let set = Command::new("date").args(["--set", &date]).output();
        assert!(set.unwrap().status.success(), "{date}");
    }
}

/// A robot on CAN under way, each of whose processes is one of the test's.
struct Robot {
    folder: PathBuf,
    log: PathBuf,
    camera: Process,
    policy: Process,
    drives: Process,
    run: Process,
}

impl Robot {
    /// Its arm moves, and its log has been written for a while.
    fn moves(topics: &str) -> Self {
        let folder = scratch(topics);
        let play = |role: &str| Process::playing(&folder, role, topics);
        let (camera, policy) = (
            play("faults::plays_a_camera"),
            play("faults::plays_a_policy"),
        );
        let mut drives = Process::start(&folder, "drives", &["drives", "--no-world"]);
        drives.await_word("no world: psm1 is nodes 1 2 3 4 5 6 7");
        let log = folder.join("run.mcap");
        let safety = repository().join("config/tasks/needle-lift/safety.toml");
        let policy_name = format!("external:{topics}");
        let run = ["run", "--backend", "can", "--topics", topics];
        let policy_of = ["--policy", &policy_name];
        let safety = ["--safety", safety.to_str().unwrap()];
        let kept = ["--log", log.to_str().unwrap()];
        let rules = ["--set", "control.policy.restarts=1"];
        let arguments = [&run[..], &policy_of, &safety, &kept, &rules].concat();
        let mut run = Process::start(&folder, "run", &arguments);
        run.until("the arm has been moving", || {
            fs::metadata(&log).is_ok_and(|log| log.len() > 300_000)
        });
        Self {
            folder,
            log,
            camera,
            policy,
            drives,
            run,
        }
    }

    /// Ends the run as a person does, at rest without a fault; what it and its drives say, and its
    /// log, which keeps all limits.
    fn interrupted(self) -> (Value, Value, RunLog) {
        self.run.signal("-INT");
        let (code, run) = self.run.end();
        assert_eq!(run["reason"], "interrupted", "{run}");
        assert_eq!(code, Some(0), "{run}");
        assert!(run["can"]["arms"][0]["fault"].is_null(), "{run}");
        let log = RunLog::open(&self.log).unwrap();
        let verified = verify(&log).unwrap();
        assert!(verified.ok, "{:?}", verified.violations.first());
        assert!(replay(&log).unwrap().identical);
        let (last, _) = log.ticks().last().unwrap();
        assert!(last.arms.first.command.velocity.amax() <= 0.0);
        drop((self.policy, self.camera));
        self.drives.signal("-INT");
        let (code, drives) = self.drives.end();
        assert_eq!(code, Some(0), "{drives}");
        (run, drives, log)
    }
}

/// After the policy and after the camera it goes on. Keeps the rows of both, timed from the last
/// chunk before.
fn assert_goes_on_twice(log: &RunLog) {
    let (mut newest, mut injected) = (0, Vec::new());
    for (tick, chunks) in log.ticks() {
        if chunks.first.is_some() {
            newest = tick.tick;
        }
        if tick.arms.first.operator == Some(OperatorEvent::Pause) {
            injected.push(newest);
        }
    }
    for (name, who, seen, injected) in [
        ("can-policy-killed", "policy", "`ended`", injected[0]),
        (
            "can-camera-killed",
            "camera",
            "`has published no frame for 2 s`",
            injected[1],
        ),
    ] {
        let fault = format!(
            "over CAN: the {who}'s process is killed, `restarts = 1` (timed from the last chunk)"
        );
        let taken = Taken::stops(log, injected);
        let again = taken.again.unwrap();
        let then = format!(
            "it comes back as another process; the arm goes on {again} ticks after its rest"
        );
        row(name, &fault, seen, &taken, &then);
    }
    let resumed = log
        .ticks()
        .enumerate()
        .filter(|(_, (tick, _))| tick.arms.first.operator == Some(OperatorEvent::GoOn))
        .map(|(at, _)| at);
    let resumed: Vec<usize> = resumed.collect();
    assert_eq!(resumed.len(), 2);
    for at in resumed {
        let mut after = log.ticks().skip(at);
        assert!(after.any(|(tick, _)| tick.arms.first.command.velocity.amax() > 0.01));
    }
}

/// The same of a robot on CAN as of simulated arms: its policy may die and come back, and its
/// camera may be gone for a while. No time that is waited for is of the clock, which is a day ahead
/// meanwhile, and then a day back.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn killed_policy_and_killed_camera_come_back() {
    let _turn = alone();
    let topics = "can_faults";
    let mut robot = Robot::moves(topics);
    set_the_clock(86_400.0);
    robot.policy.signal("-KILL");
    let run = &mut robot.run;
    run.await_word("it may come back within 30.0 s (1 of 1)");
    robot.policy = Process::playing(&robot.folder, "faults::plays_a_policy", topics);
    run.await_word(", is ready again");
    set_the_clock(-172_800.0);
    pass_ms(600);
    robot.camera.signal("-KILL");
    run.await_word("camera scope has published no frame for 2 s; the arms stop and hold");
    robot.camera = Process::playing(&robot.folder, "faults::plays_a_camera", topics);
    run.await_word("the cameras show frames again");
    run.await_word("the policy answers again");
    pass_ms(600);
    let (run, _, log) = robot.interrupted();
    assert_eq!(run["policy"]["restarts"], 1, "{run}");
    assert_goes_on_twice(&log);
}

/// By how much the clock was set, s, as the log says, and when.
fn settings(log: &Path) -> Vec<(TimeNs, f64)> {
    let mut found = Vec::new();
    read_items(log, |item| {
        let LoggedItem::Event { at, text } = item else {
            return;
        };
        let Some(how) = text.strip_prefix("the system's clock was set ") else {
            return;
        };
        let (way, rest) = how.split_once(" by ").unwrap();
        let by_s: f64 = rest.split_once(" s and says ").unwrap().0.parse().unwrap();
        found.push((at, if way == "ahead" { by_s } else { -by_s }));
    })
    .unwrap();
    found
}

/// The clock is set while the arm moves, by an hour and by 0.1 s, ahead and back. The loop, the
/// ages of chunks and frames, watchdogs and the log's times go by another: nothing is refused,
/// missed or held, and the log says when the clock was set.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn setting_the_clock_changes_nothing() {
    let _turn = alone();
    if !has_a_clock_of_its_own() {
        return;
    }
    let robot = Robot::moves("can_clock");
    let jumps_s = [3600.0, -7200.0, 3600.0, 0.1, -0.1];
    for by_s in jumps_s {
        set_the_clock(by_s);
        pass_ms(500);
    }
    let path = robot.log.clone();
    let (run, drives, log) = robot.interrupted();
    assert_eq!(run["policy"]["refused"], 0, "{run}");
    assert!(run["policy"].get("restarts").is_none(), "{run}");
    for stop in drives["stops"].as_array().unwrap() {
        assert_eq!(stop["cause"], "its master switched it off", "{drives}");
    }
    let asked = log.ticks().filter_map(|(tick, _)| tick.arms.first.operator);
    let expected = [
        OperatorEvent::Enable,
        OperatorEvent::Pause,
        OperatorEvent::Disable,
    ];
    assert_eq!(asked.collect::<Vec<_>>(), expected, "{:?}", log.events);
    let ticks: Vec<(u64, TimeNs)> = log.ticks().map(|(it, _)| (it.tick, it.now)).collect();
    for two in ticks.windows(2) {
        let (passed_ns, ticks) = (two[1].1.since(two[0].1), two[1].0 - two[0].0);
        assert!(passed_ns.abs_diff(ticks * TICK_NS) < TICK_NS, "{two:?}");
    }
    let found = settings(&path);
    assert_eq!(found.len(), jumps_s.len(), "{found:?}");
    for ((at, by_s), wanted_s) in found.into_iter().zip(jumps_s) {
        // `date` takes its time, and both ways it is lost.
        assert!((by_s - wanted_s).abs() < 0.09, "{by_s} s for {wanted_s} s");
        let later = log.ticks().skip_while(|(tick, _)| tick.now < at).take(400);
        let speed = later.map(|(tick, _)| tick.arms.first.command.velocity.amax());
        assert!(speed.fold(0.0, f64::max) > 0.01, "it moves on after {at:?}");
    }
    let fault = "over CAN: the system's clock is set in mid-motion, ahead and back, by an hour and by 0.1 s";
    let taken = Taken::goes_on(&log, None);
    let then = "the log says when and by how much; its own times go on";
    row(
        "can-clock-jumps",
        fault,
        "`the system's clock was set ...`, by the log alone",
        &taken,
        then,
    );
}
