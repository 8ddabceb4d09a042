//! A robot on CAN whose policy's process is killed and comes back, while the clock is set, and whose camera's process is killed.
#![expect(clippy::print_stdout, reason = "the fault table has what it prints")]

use std::env;
use std::fs;
use std::process::Command;

use hal::{Intrinsics, Pose, TICK_NS};
use tests::{repository, scratch};
use trocar::rt::{MonotonicClock, Periodic, sleep_ns};
use trocar_control::OperatorEvent;
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_topics::{CameraTopic, FrameHeader, TopicNode};

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

/// Sets the clock of the kernel inside this one by so many seconds; another machine's is left alone.
fn set_the_clock(by_s: i64) -> bool {
    let inside = fs::read_to_string("/proc/cpuinfo")
        .unwrap()
        .contains("User Mode Linux");
    if inside {
        let date = format!("now {by_s:+} seconds");
        let set = Command::new("date").args(["--set", &date]).output();
        assert!(set.unwrap().status.success(), "{date}");
    }
    inside
}

/// Ticks from the pause until the arm is at rest, and whether it moves after it is resumed; no chunk from before the pause is followed.
fn stop_and_return(log: &RunLog) -> (usize, bool) {
    let asked = |event| {
        let mut ticks = log.ticks();
        ticks
            .position(|(tick, _)| tick.arms.first.operator == Some(event))
            .unwrap()
    };
    let (pause, resume) = (asked(OperatorEvent::Pause), asked(OperatorEvent::GoOn));
    let fastest = |tick: &trocar_log::LoggedTick| tick.arms.first.command.velocity.amax();
    let rest = log
        .ticks()
        .skip(pause)
        .position(|(tick, _)| fastest(tick) <= 0.0);
    let mut after = log.ticks().skip(resume);
    (rest.unwrap(), after.any(|(tick, _)| fastest(tick) > 0.01))
}

/// After the policy and after the camera it goes on.
fn assert_goes_on_twice(log: &RunLog) {
    let resumed: Vec<usize> = log
        .ticks()
        .enumerate()
        .filter(|(_, (tick, _))| tick.arms.first.operator == Some(OperatorEvent::GoOn))
        .map(|(at, _)| at)
        .collect();
    assert_eq!(resumed.len(), 2);
    let mut again = log.ticks().skip(resumed[1]);
    assert!(again.any(|(tick, _)| tick.arms.first.command.velocity.amax() > 0.01));
}

/// The same of a robot on CAN as of simulated arms: its policy may die and come back, the clock may jump, and its camera may be gone for
/// a while.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn killed_policy_and_killed_camera_come_back() {
    let _turn = alone();
    let folder = scratch("can_faults");
    let topics = "can_faults";
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
    let mut run = Process::start(
        &folder,
        "run",
        &[&run[..], &policy_of, &safety, &kept, &rules].concat(),
    );
    run.until("the arm has been moving", || {
        fs::metadata(&log).is_ok_and(|log| log.len() > 300_000)
    });
    let mut clock_jumped = set_the_clock(86_400);
    policy.signal("-KILL");
    run.await_word("it may come back within 30.0 s (1 of 1)");
    drop(policy);
    let policy = play("faults::plays_a_policy");
    run.await_word(", is ready again");
    clock_jumped &= set_the_clock(-2 * 86_400);
    pass_ms(600);
    camera.signal("-KILL");
    run.await_word("camera scope has published no frame for 2 s; the arms stop and hold");
    drop(camera);
    let camera = play("faults::plays_a_camera");
    run.await_word("the cameras show frames again");
    run.await_word("the policy answers again");
    pass_ms(600);
    run.signal("-INT");
    let (code, run) = run.end();
    assert_eq!(run["reason"], "interrupted", "{run}");
    assert_eq!(code, Some(0), "{run}");
    assert_eq!(run["policy"]["restarts"], 1, "{run}");
    assert!(run["can"]["arms"][0]["fault"].is_null(), "{run}");
    let log = RunLog::open(&log).unwrap();
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations.first());
    assert!(replay(&log).unwrap().identical);
    let (rest, returns) = stop_and_return(&log);
    assert!(returns && rest < 500, "at rest after {rest} ticks");
    assert_goes_on_twice(&log);
    let (last, _) = log.ticks().last().unwrap();
    assert!(last.arms.first.command.velocity.amax() <= 0.0);
    println!(
        "over CAN: at rest {rest} ms after the pause, moves again; clock set {clock_jumped}; \
         a camera's end is a smooth stop, after which the arm goes on"
    );
    drop((policy, camera));
    drives.signal("-INT");
    assert_eq!(drives.end().0, Some(0));
}
