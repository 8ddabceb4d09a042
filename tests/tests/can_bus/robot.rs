//! A robot without a simulator: `trocar run --safety`, with `trocar drives --no-world` in the place
//! of its drives.

use std::fs;
use std::path::Path;

use tests::{repository, scratch, trocar};
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{BusesRecord, LoggedItem, RunLog, read_items};

use super::pair::Process;
use super::peer::{alone, said};

/// A robot without a simulator runs within its limits until its time is up.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn robot_runs_without_a_simulator() {
    let _turn = alone();
    let folder = scratch("can_robot");
    let mut drives = Process::start(&folder, "drives", &["drives", "--no-world"]);
    drives.await_word("no world: psm1 is nodes 1 2 3 4 5 6 7");
    let log = folder.join("run.mcap");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let arguments = ["run", "--backend", "can", "--policy", "random"];
    let files = [
        "--safety",
        safety.to_str().unwrap(),
        "--log",
        log.to_str().unwrap(),
    ];
    let arguments = [&arguments[..], &files, &["--seconds", "1.5"]].concat();
    let (code, run) = Process::start(&folder, "run", &arguments).end();
    assert_eq!(code, Some(0), "{run}");
    assert_eq!(run["reason"], "the 1.5 s are over", "{run}");
    for absent in ["task", "success", "view"] {
        assert!(run.get(absent).is_none(), "{run}");
    }
    assert!(run["policy"]["queries"].as_u64() > Some(5), "{run}");
    says_how_its_buses_were(&log);
    let log = RunLog::open(&log).unwrap();
    assert_eq!(
        (log.header.task.as_str(), log.text("scene.toml")),
        ("", None)
    );
    assert_eq!(
        log.outcome.as_ref().map(|outcome| outcome.success),
        Some(None)
    );
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations.first());
    assert!(replay(&log).unwrap().identical);
    drives.signal("-INT");
    let (code, drives) = drives.end();
    assert_eq!(code, Some(0), "{drives}");
    assert!(drives["begun_s"].as_f64().is_some(), "{drives}");
    assert!(drives.get("outcome").is_none(), "{drives}");
}

/// The log has twice a second what the kernel counted on the arm's interfaces: some load once a
/// second is over, no errors.
fn says_how_its_buses_were(log: &Path) {
    let mut told = Vec::new();
    read_items(log, |item| {
        if let LoggedItem::Buses { message, .. } = item {
            told.push(BusesRecord::read(message.as_bytes()).unwrap().buses);
        }
    })
    .unwrap();
    assert!((3..12).contains(&told.len()), "{told:?}");
    let newest = told.last().unwrap();
    assert!(
        newest.iter().any(|bus| bus.interface == "vcan0"),
        "{told:?}"
    );
    for bus in newest {
        assert!(bus.frames_per_s > 1000.0 && bus.load > 0.1, "{told:?}");
        assert_eq!(bus.errors, 0, "{told:?}");
    }
}

/// A camera that shows nothing is named and no drive is spoken to.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn missing_camera_is_named_before_any_drive_is_used() {
    let _turn = alone();
    let policy = repository().join("config/policies/needle-lift/act-compact");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let output = trocar()
        .args(["run", "--backend", "can", "--topics", "can_robot_blind"])
        .args(["--policy", policy.to_str().unwrap()])
        .args(["--safety", safety.to_str().unwrap()])
        .output()
        .unwrap();
    let told = said(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    let waits = "waiting for a frame of camera endoscope on topics \"can_robot_blind\", for 10 s at most; no drive has torque";
    assert!(told.contains(waits), "{told}");
    assert!(
        told.contains(
            "camera endoscope has published no frame on topics \"can_robot_blind\" for 10 s"
        ),
        "{told}"
    );
}

/// A world whose own drives nobody starts ends the run with its reason before any drive has torque.
#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn world_with_disabled_drives_ends_the_run() {
    let _turn = alone();
    let folder = scratch("can_other_world");
    let shipped = fs::read_to_string(repository().join("config/can.toml")).unwrap();
    let other = folder.join("can.toml");
    fs::write(&other, shipped.replace("vcan0", "vcan1")).unwrap();
    let other = other.to_str().unwrap();
    let topics = ["--topics", "can_other_world"];
    let mut world = Process::start(&folder, "world", &[&["drives"], &topics[..]].concat());
    let no_world = ["drives", "--no-world", "--config", other];
    let mut drives = Process::start(&folder, "drives", &no_world);
    world.await_word("psm1 is nodes 1 2 3 4 5 6 7");
    drives.await_word("no world: psm1 is nodes 1 2 3 4 5 6 7");
    let run = ["run", "--task", "needle-lift", "--policy", "expert"];
    let on = ["--backend", "can", "--can-config", other];
    let mut run = Process::start(&folder, "run", &[&run[..], &on, &topics].concat());
    run.await_word("waiting for the drives of the world to be operational; no drive has torque");
    let (code, said) = run.wait();
    assert_eq!(code, Some(1), "{said}");
    let reason = "the drives of the world are not operational: are ours its own? (3 s)";
    assert!(said.contains(reason), "{said}");
    world.signal("-INT");
    drives.signal("-INT");
    let (code, drives) = drives.end();
    assert_eq!(code, Some(0));
    assert!(
        drives["begun_s"].is_null(),
        "no drive was enabled: {drives}"
    );
}
