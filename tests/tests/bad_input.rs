//! Bad input ends with exit code 2 and a message that says what is wrong and where.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;

use tests::{Profile, repository, scratch, stderr, trocar};

const COMMITTED: &str = "config/policies/needle-lift/act-small";

/// Runs `trocar` with `arguments`, expects exit code 2, and gives the message.
fn refused(arguments: &[&str]) -> String {
    let output = trocar(Profile::Release).args(arguments).output().unwrap();
    assert_eq!(
        output.status.code(),
        Some(2),
        "{arguments:?}: {}",
        stderr(&output)
    );
    stderr(&output)
}

fn run_with_config(text: &str, name: &str) -> String {
    let path = scratch(name).join("control.toml");
    fs::write(&path, text).unwrap();
    let path = path.display().to_string();
    refused(&[
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "expert",
        "--lockstep",
        "--config",
        &path,
    ])
}

fn built_in_config() -> String {
    fs::read_to_string(repository().join("config/control.toml")).unwrap()
}

/// A copy of the committed checkpoint that `damage` may spoil.
fn run_with_checkpoint(name: &str, damage: impl Fn(&Path)) -> String {
    let folder = scratch(name).join("checkpoint");
    fs::create_dir_all(&folder).unwrap();
    for entry in fs::read_dir(repository().join(COMMITTED)).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), folder.join(entry.file_name())).unwrap();
    }
    damage(&folder);
    let folder = folder.display().to_string();
    refused(&[
        "run",
        "--task",
        "needle-lift",
        "--lockstep",
        "--policy",
        &folder,
    ])
}

#[test]
fn unknown_key_names_file_line_and_key() {
    let text = format!("{}\n[nonsense]\nspeed = 1\n", built_in_config());
    let line = text.lines().count() - 1;
    let message = run_with_config(&text, "unknown-key");
    assert!(
        message.contains("control.toml") && message.contains("nonsense"),
        "{message}"
    );
    assert!(message.contains(&format!(":{line}:")), "{message}");
}

#[test]
fn value_out_of_range_names_line_key_and_range() {
    let text = built_in_config();
    let (index, line) = text
        .lines()
        .enumerate()
        .find(|(_, line)| line.starts_with("gain_1_s"))
        .expect("the key exists");
    let text = text.replace(line, "gain_1_s = 7500.0");
    let message = run_with_config(&text, "out-of-range");
    assert!(
        message.contains("tracking.gain_1_s = 7500 is outside"),
        "{message}"
    );
    assert!(message.contains(&format!(":{}:", index + 1)), "{message}");
}

#[test]
fn missing_checkpoint_is_named() {
    let message = refused(&[
        "run",
        "--task",
        "needle-lift",
        "--lockstep",
        "--policy",
        "runs/nowhere",
    ]);
    assert!(message.contains("runs/nowhere"), "{message}");
}

#[test]
fn truncated_weights_are_refused() {
    let message = run_with_checkpoint("truncated-weights", |folder| {
        let weights = folder.join("model.safetensors");
        let bytes = fs::read(&weights).unwrap();
        fs::write(&weights, &bytes[..bytes.len() / 2]).unwrap();
    });
    assert!(message.contains("model.safetensors"), "{message}");
}

#[test]
fn missing_weights_are_refused() {
    let message = run_with_checkpoint("missing-weights", |folder| {
        fs::remove_file(folder.join("model.safetensors")).unwrap();
    });
    assert!(message.contains("model.safetensors"), "{message}");
}

#[test]
fn checkpoint_for_another_number_of_joints_is_refused() {
    let message = run_with_checkpoint("other-joints", |folder| {
        let path = folder.join("config.json");
        let mut config: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        config["input_features"]["observation.state"]["shape"] = serde_json::json!([14]);
        fs::write(&path, config.to_string()).unwrap();
    });
    assert!(message.contains("14") && message.contains('7'), "{message}");
}

#[test]
fn unreadable_log_is_refused() {
    let path = scratch("no-log").join("text.mcap");
    fs::write(&path, "this is no log").unwrap();
    let path = path.display().to_string();
    for verb in ["replay", "verify"] {
        let message = refused(&[verb, &path]);
        assert!(message.contains("text.mcap"), "{message}");
    }
}

#[test]
fn unknown_task_and_option_are_usage_errors() {
    assert!(refused(&["run", "--task", "tonsils", "--policy", "expert"]).contains("needle-lift"));
    assert!(refused(&["eval", "--task", "needle-lift"]).contains("--policy"));
}
