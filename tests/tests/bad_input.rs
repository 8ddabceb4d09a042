//! Bad input ends with exit code 2 and a message that says what is wrong and where.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tests::{repository, scratch, stderr, trocar};

const COMMITTED: &str = "config/policies/needle-lift/act-compact";

/// Runs `trocar` with `arguments`, expects exit code 2, and gives the message.
fn refused(arguments: &[&str]) -> String {
    let output = trocar().args(arguments).output().unwrap();
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

/// A copy of the committed checkpoint.
fn checkpoint(name: &str) -> PathBuf {
    let folder = scratch(name).join("checkpoint");
    fs::create_dir_all(&folder).unwrap();
    for entry in fs::read_dir(repository().join(COMMITTED)).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), folder.join(entry.file_name())).unwrap();
    }
    folder
}

/// A run with a checkpoint that `damage` may spoil; in real time, where another process loads it,
/// the same is said.
fn run_with_checkpoint(name: &str, damage: impl Fn(&Path)) -> String {
    let folder = checkpoint(name);
    damage(&folder);
    let folder = folder.display().to_string();
    let run = ["run", "--task", "needle-lift", "--policy", &folder];
    let message = refused(&[&run[..], &["--lockstep"]].concat());
    let in_real_time = refused(&run);
    assert!(in_real_time.contains(message.trim()), "{in_real_time}");
    message
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

/// What `trocar` with `arguments` says within a minute; it is killed after that, since a pipe that
/// nobody writes to is waited for without end.
fn within_a_minute(arguments: &[&str]) -> Output {
    let mut command = trocar();
    command.args(arguments).stdout(Stdio::null());
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let ended = (0..600).any(|_| {
        trocar::rt::sleep_ns(100_000_000);
        child.try_wait().unwrap().is_some()
    });
    if !ended {
        child.kill().unwrap();
    }
    assert!(ended, "{arguments:?}: it waits");
    child.wait_with_output().unwrap()
}

#[test]
fn pipe_in_place_of_a_checkpoints_file_is_refused() {
    let folder = checkpoint("piped-checkpoint");
    let policy = folder.display().to_string();
    for name in [
        "trocar.json",
        "config.json",
        "policy_preprocessor.json",
        "policy_preprocessor_step_3_normalizer_processor.safetensors",
        "model.safetensors",
    ] {
        let (file, aside) = (folder.join(name), folder.join("aside"));
        fs::rename(&file, &aside).unwrap();
        let made = Command::new("mkfifo").arg(&file).status().unwrap();
        assert!(made.success());
        let eval = ["eval", "--task", "needle-lift", "--trials", "1"];
        let output = within_a_minute(&[&eval[..], &["--policy", &policy]].concat());
        let told = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{name}: {told}");
        let expected = format!("{name}: it is a device, a pipe or a socket, not a file");
        assert!(told.contains(&expected), "{told}");
        fs::rename(&aside, &file).unwrap();
    }
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

/// A training that is refused, with `changes` after the options that make it whole.
fn training_refused(data: &Path, out: &Path, changes: &[&str]) -> String {
    let (data, out) = (data.display().to_string(), out.display().to_string());
    let mut arguments = vec!["train", "--policy", "act", "--data", &data, "--out", &out];
    arguments.extend(changes);
    refused(&arguments)
}

#[test]
fn training_on_no_dataset_or_a_damaged_one_is_refused() {
    let folder = scratch("no-dataset");
    let message = training_refused(&folder.join("nowhere"), &folder.join("out"), &[]);
    assert!(message.contains("info.json"), "{message}");
    assert_eq!(message.matches("No such file").count(), 1, "{message}");

    fs::create_dir_all(folder.join("damaged/meta")).unwrap();
    fs::write(folder.join("damaged/meta/info.json"), "{\"fps\": ").unwrap();
    let message = training_refused(&folder.join("damaged"), &folder.join("out"), &[]);
    assert!(message.contains("info.json"), "{message}");
    assert_eq!(message.matches("EOF").count(), 1, "{message}");
}

#[test]
fn training_with_impossible_options_is_refused() {
    let folder = scratch("impossible-training");
    let (data, out) = (folder.join("data"), folder.join("out"));
    for (option, value) in [
        ("--episodes", "0"),
        ("--steps", "0"),
        ("--batch", "0"),
        ("--threads", "0"),
        ("--validation-share", "2"),
        ("--validation-share", "nan"),
        ("--preset", "huge"),
        ("--lr", "nan"),
        ("--state-noise", "nan"),
    ] {
        let message = training_refused(&data, &out, &[option, value]);
        let name = option.trim_start_matches("--").replace('-', "_");
        assert!(
            message.contains(option) || message.contains(&name),
            "{message}"
        );
    }
    assert!(!out.exists());
}

#[test]
fn training_into_a_folder_with_content_is_refused() {
    let data = scratch("training-over-data");
    fs::write(data.join("precious"), "data").unwrap();
    let message = training_refused(&data, &data, &[]);
    assert!(message.contains("not an empty folder"), "{message}");
    let message = training_refused(&data, &data.join("precious"), &[]);
    assert!(message.contains("is no folder"), "{message}");
    assert_eq!(fs::read_to_string(data.join("precious")).unwrap(), "data");
}

#[test]
fn recording_nothing_or_over_something_is_refused() {
    let folder = scratch("recording-over");
    fs::write(folder.join("precious"), "data").unwrap();
    let out = folder.display().to_string();
    let record = ["record", "--task", "needle-lift", "--out", &out];
    let message = refused(&[&record[..], &["--episodes", "1"]].concat());
    assert!(message.contains("not an empty folder"), "{message}");
    let message = refused(&[&record[..], &["--episodes", "0"]].concat());
    assert!(message.contains("--episodes"), "{message}");
}

const EVAL: [&str; 5] = ["eval", "--task", "needle-lift", "--policy", "expert"];

#[test]
fn evaluation_of_nothing_by_nobody_or_too_late_is_refused() {
    for (option, value) in [
        ("--trials", "0"),
        ("--jobs", "0"),
        ("--jobs", "18446744073709551615"),
        ("--latency-ms", "18446744073709551615"),
    ] {
        let message = refused(&[&EVAL[..], &[option, value]].concat());
        assert!(message.contains(option), "{message}");
    }
}

#[test]
fn result_that_cannot_be_written_is_refused_before_the_work() {
    let file = scratch("unwritable").join("file");
    fs::write(&file, "a file").unwrap();
    let below = file.join("result.json").display().to_string();
    let message = refused(&[&EVAL[..], &["--trials", "1000000", "--json", &below]].concat());
    assert!(message.contains("--json"), "{message}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "a file");
}

#[test]
fn log_and_result_in_one_file_are_refused() {
    let path = scratch("one-file").join("both").display().to_string();
    let run = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "expert",
        "--lockstep",
    ];
    let message = refused(&[&run[..], &["--log", &path, "--json", &path]].concat());
    assert!(message.contains("--log names the same"), "{message}");
}

#[test]
fn misspelt_policy_is_told_what_a_policy_can_be() {
    let message = refused(&["eval", "--task", "needle-lift", "--policy", "exprt"]);
    for name in ["exprt", "expert", "noop", "random", "folder"] {
        assert!(message.contains(name), "{message}");
    }
}

#[test]
fn value_of_the_wrong_type_names_line_and_dotted_key() {
    let text = built_in_config();
    let (index, line) = text
        .lines()
        .enumerate()
        .find(|(_, line)| line.starts_with("gain_1_s"))
        .expect("the key exists");
    let text = text.replace(line, "gain_1_s = \"x\"");
    let message = run_with_config(&text, "wrong-type");
    assert!(
        message.contains(&format!(":{}: tracking.gain_1_s: invalid type", index + 1)),
        "{message}"
    );
}

#[test]
fn checkpoint_for_a_camera_that_the_task_lacks_is_refused() {
    let (known, strange) = (&b"images.endoscope"[..], &b"images.periscope"[..]);
    let message = run_with_checkpoint("strange-camera", |folder| {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let mut bytes = fs::read(&path).unwrap();
            for at in 0..bytes.len().saturating_sub(known.len()) {
                if bytes[at..].starts_with(known) {
                    bytes[at..at + known.len()].copy_from_slice(strange);
                }
            }
            fs::write(&path, bytes).unwrap();
        }
    });
    assert!(
        message.contains("needs camera \"periscope\"")
            && message.contains("endoscope, side, wrist"),
        "{message}"
    );
}

#[test]
fn simulated_operators_that_cannot_be_are_refused() {
    let out = scratch("refused-operator")
        .join("demos")
        .display()
        .to_string();
    let fixed = [
        "record",
        "--task",
        "needle-lift",
        "--episodes",
        "1",
        "--out",
        &out,
    ];
    let fixed = [&fixed[..], &["--source", "simulated-operator"]].concat();
    for (options, expected) in [
        (["--operator-delay-ms", "501"], "0..=500"),
        (["--operator-delay-ms", "-1"], "unexpected argument"),
        (["--operator-tremor-mm", "2.5"], "[0, 2]"),
        (["--operator-tremor-mm", "-0.1"], "unexpected argument"),
        (["--operator-tremor-mm", "NaN"], "[0, 2]"),
        (["--disturb", "0.5"], "--disturb needs --source expert"),
        (
            ["--policy", "expert"],
            "--policy needs --source intervention",
        ),
        (["--source", "expert"], "cannot be used multiple times"),
    ] {
        let message = refused(&[&fixed[..], &options].concat());
        assert!(message.contains(expected), "{options:?}: {message}");
    }
    let run = ["run", "--task", "needle-lift", "--policy"];
    let message = refused(&[&run[..], &["simulated-operator"]].concat());
    assert!(message.contains("--lockstep"), "{message}");
    let expert = ["expert", "--lockstep", "--operator-delay-ms", "0"];
    let message = refused(&[&run[..], &expert].concat());
    assert!(message.contains("expert is another"), "{message}");
    assert!(!Path::new(&out).exists());
}

#[test]
fn disturbances_and_variations_that_cannot_be_are_refused() {
    let folder = scratch("refused-variations");
    let out = folder.join("demos").display().to_string();
    let record = |task: &str, options: &[&str]| {
        let fixed = ["record", "--task", task, "--episodes", "1", "--out", &out];
        refused(&[&fixed[..], options].concat())
    };
    for share in ["0", "1.5", "NaN", "half"] {
        let message = record("needle-lift", &["--disturb", share]);
        assert!(message.contains("above 0, up to 1"), "{message}");
    }
    let message = record("needle-lift", &["--vary", "colours"]);
    assert!(message.contains("needles, views, light, lens"), "{message}");
    let message = record("suture-pad", &["--vary", "light,needles"]);
    assert!(
        message.contains(
            "--vary needles: suture-pad has no choice of needles; it can vary views, light, lens"
        ),
        "{message}"
    );
    let message = record("needle-lift", &["--vary", "views", "--view", "view1"]);
    assert!(
        message.contains("--view chooses one for all episodes"),
        "{message}"
    );
    let message = record("needle-lift", &["--vary", "lens", "--depth"]);
    assert!(
        message.contains("--vary lens: --depth keeps one lens a camera"),
        "{message}"
    );
    let message = record("needle-lift", &["--vary", "smoke,distortion", "--depth"]);
    assert!(
        message.contains("--vary distortion: --depth keeps one lens a camera"),
        "{message}"
    );
    assert!(!Path::new(&out).exists());
}
