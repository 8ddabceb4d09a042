//! Lockstep is reproducible: one seed gives one command hash, in any process and any build; a log
//! replays to the bit.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tests::{json, repository, scratch, stderr, trocar, trocar_release};
use trocar_log::RunLog;
use trocar_log::verify::verify;

/// Runs the expert in lockstep and gives the result.
fn run(folder: &Path, seed: u64, log: Option<&Path>) -> serde_json::Value {
    run_of(trocar(), folder, seed, log)
}

fn run_of(mut command: Command, folder: &Path, seed: u64, log: Option<&Path>) -> serde_json::Value {
    let result = folder.join(format!("{seed}.json"));
    command.args([
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "expert",
        "--lockstep",
    ]);
    command
        .args(["--seed", &seed.to_string(), "--json"])
        .arg(&result);
    if let Some(log) = log {
        command.arg("--log").arg(log);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    json(&result)
}

/// Runs `replay` or `verify` on `log`.
fn log_command(name: &str, log: &Path, result: Option<&Path>) -> Output {
    let mut command = trocar();
    command.arg(name).arg(log);
    if let Some(result) = result {
        command.arg("--json").arg(result);
    }
    command.output().unwrap()
}

/// One seed gives one hash and another seed another.
#[test]
fn one_seed_gives_one_hash() {
    let folder = scratch("hashes");
    let plain = run(&folder, 3, None);
    let logged = run(&folder, 3, Some(&folder.join("logged.mcap")));
    let other = run(&folder, 4, None);
    assert_eq!(
        logged["command_hash"], plain["command_hash"],
        "cameras and the log must not change the run"
    );
    assert_ne!(other["command_hash"], plain["command_hash"]);
    let output = log_command("verify", &folder.join("logged.mcap"), None);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
}

/// Neither assertions nor what is optimised change a run.
#[test]
#[ignore = "needs the release binary: `make test-release` runs it"]
fn the_release_gives_the_same_hash() {
    let folder = scratch("hashes-release");
    for seed in [3, 4] {
        let tested = run(&folder, seed, None);
        let released = run_of(trocar_release(), &folder, seed, None);
        assert_eq!(tested["command_hash"], released["command_hash"]);
    }
}

#[test]
fn a_log_replays_verifies_and_catches_tampering() {
    let folder = scratch("log");
    let log = folder.join("run.mcap");
    let result = run(&folder, 11, Some(&log));
    assert_eq!(result["success"], true, "{result}");

    let replayed = folder.join("replay.json");
    let output = log_command("replay", &log, Some(&replayed));
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(json(&replayed)["identical"], true);
    assert_eq!(json(&replayed)["ticks"], result["ticks"]);
    assert_eq!(json(&replayed)["inputs_checked"], true);

    let verified = folder.join("verify.json");
    let output = log_command("verify", &log, Some(&verified));
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stdout)
    );
    assert_eq!(json(&verified)["ok"], true);

    // One flipped bit anywhere in the data is found by the container's checksum.
    let whole = fs::read(&log).unwrap();
    let mut bytes = whole.clone();
    let middle = bytes.len() / 3;
    bytes[middle] ^= 0x10;
    let flipped = folder.join("flipped.mcap");
    fs::write(&flipped, &bytes).unwrap();
    for name in ["replay", "verify"] {
        let output = log_command(name, &flipped, None);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert!(
            message.contains("flipped.mcap") && message.contains("damaged at byte"),
            "{name}: {message}"
        );
    }

    // A cut log is readable up to the cut.
    let cut = folder.join("cut.mcap");
    fs::write(&cut, &whole[..middle * 2]).unwrap();
    for name in ["replay", "verify"] {
        let cut_json = folder.join(format!("cut-{name}.json"));
        let output = log_command(name, &cut, Some(&cut_json));
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert!(message.contains("cut off"), "{name}: {message}");
        assert!(json(&cut_json)["cut"].is_string(), "{name}");
        let ticks = json(&cut_json)["ticks"].as_u64().unwrap();
        assert!(
            ticks > 500 && ticks < result["ticks"].as_u64().unwrap(),
            "{name}: {ticks}"
        );
    }
}

/// An arm that is enabled within a forbidden region only comes out as verify sees it.
#[test]
fn arm_in_a_forbidden_region_only_comes_out() {
    let folder = scratch("enabled_within").join("task");
    fs::create_dir_all(&folder).unwrap();
    let shipped = repository().join("config/tasks/needle-lift");
    fs::copy(shipped.join("scene.toml"), folder.join("scene.toml")).unwrap();
    let limits = fs::read_to_string(shipped.join("safety.toml")).unwrap();
    let regions = [
        "shape = \"sphere\"\ncenter_m = [0.0, 0.0, 0.045]\nradius_m = 0.02\n",
        "shape = \"half_space\"\npoint_m = [0.0, 0.0, 0.06]\nnormal = [0.0, 0.0, 1.0]\n",
        "shape = \"box\"\ncenter_m = [0.005, 0.0, 0.05]\nsize_m = [0.04, 0.03, 0.03]\nrpy_rad = [0.0, 0.0, 0.3]\n",
    ];
    for (region, seed) in regions.iter().zip(["950100", "950101", "950102"]) {
        let text = format!("{limits}\n[[forbidden]]\nname = \"start\"\n{region}");
        fs::write(folder.join("safety.toml"), text).unwrap();
        let log = folder.join("run.mcap");
        let output = trocar()
            .args(["run", "--policy", "random", "--lockstep", "--seed", seed])
            .args(["--set", "scene.episode.time_limit_s=4"])
            .arg("--task")
            .arg(&folder)
            .arg("--log")
            .arg(&log)
            .output()
            .unwrap();
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert!(
            told.contains("psm1 is enabled ") && told.contains(" mm beyond forbidden.start ("),
            "{told}"
        );
        let verified = verify(&RunLog::open(&log).unwrap()).unwrap();
        let first = verified.violations.first();
        assert!(
            verified.ok,
            "{region}: {} of {first:?}",
            verified.violations.len()
        );
        assert!(verified.ticks > 3900, "{region}");
    }
}
