//! A robot on CAN whose policy's process is killed and comes back, while the clock is set, and whose camera's process is killed.

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

/// After the policy and after the camera it goes on; what the clock does, if it jumped, does nothing. Keeps the rows of all three, timed from
/// the last chunk before.
fn assert_goes_on_twice(log: &RunLog, clock_jumped: bool) {
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
    if clock_jumped {
        let fault = "over CAN: the system's clock jumps a day ahead, then two back";
        let taken = Taken::goes_on(log, None);
        row("can-clock-jumps", fault, "by nothing", &taken, "-");
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
    assert_goes_on_twice(&log, clock_jumped);
    let (last, _) = log.ticks().last().unwrap();
    assert!(last.arms.first.command.velocity.amax() <= 0.0);
    drop((policy, camera));
    drives.signal("-INT");
    assert_eq!(drives.end().0, Some(0));
}
