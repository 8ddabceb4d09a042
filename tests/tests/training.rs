//! A training in a process of its own that is interrupted keeps its state, and ends with the bytes
//! of one that was not.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use hal::Intrinsics;
use tests::{json, repository, scratch, stderr, trocar};
use trocar_data::dataset::{
    ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, DepthFrame, FrameRecord,
};

const SIDE: u32 = 16;
const PIXELS: usize = (SIDE * SIDE) as usize;

/// One episode of a needle that comes nearer, seen by one camera with depth.
fn record(folder: &Path) {
    record_steps(folder, 8);
}

fn record_steps(folder: &Path, steps: u16) {
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "needle-lift".to_owned(),
        cameras: vec![CameraSpec {
            name: "endoscope".to_owned(),
            width: SIDE,
            height: SIDE,
            depth: Some(Intrinsics::from_vertical_fov(SIDE, SIDE, 0.8)),
        }],
        intervention: false,
    };
    let mut writer = DatasetWriter::create(folder, &spec).unwrap();
    for step in 0..steps {
        let units: Vec<u16> = (0..PIXELS).map(|_| 5000 + 40 * step).collect();
        let along = 0.001 * f64::from(step);
        let depth = DepthFrame {
            units: &units,
            instance: &[2; PIXELS],
            camera_in_scene: [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0],
        };
        let arm = ArmFrame {
            state: [0.01 * f32::from(step); 7],
            tip_pose: [along, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0],
            action: [along + 0.001, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0, 0.5],
        };
        let record = FrameRecord {
            arms: &[arm],
            images: &[&[7; 3 * PIXELS]],
            depth: &[depth],
        };
        writer.push_frame(&record).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}

/// `trocar train` of the small diffusion network on few points, for a dozen steps.
fn train(folder: &Path, out: &str) -> Command {
    train_steps(folder, out, "12")
}

fn train_steps(folder: &Path, out: &str, steps: &str) -> Command {
    let path = |name: &str| folder.join(name).display().to_string();
    let clouds =
        "frame = \"scene\"\ndropped_instances = [0]\npoints = 32\npadding = \"first_point\"\n";
    fs::write(path("clouds.toml"), clouds).unwrap();
    let mut command = trocar();
    command.args([
        "train",
        "--policy",
        "dp3",
        "--preset",
        "simple",
        "--threads",
        "1",
    ]);
    command.args([
        "--steps",
        steps,
        "--batch",
        "2",
        "--data",
        &path("data"),
        "--out",
        &path(out),
    ]);
    command.args(["--clouds", &path("clouds.toml")]);
    command
}

/// The needle lift with a second to do it in, seen as the recording sees it.
fn hasty_task(folder: &Path) -> String {
    let task = folder.join("hasty-lift");
    fs::create_dir_all(&task).unwrap();
    let built_in = repository().join("config/tasks/needle-lift");
    fs::copy(built_in.join("safety.toml"), task.join("safety.toml")).unwrap();
    let scene = fs::read_to_string(built_in.join("scene.toml")).unwrap();
    let changed = scene
        .replace("time_limit_s = 12.0", "time_limit_s = 1.0")
        .replace("width = 512", &format!("width = {SIDE}"))
        .replace("height = 512", &format!("height = {SIDE}"));
    assert_ne!(changed, scene);
    fs::write(task.join("scene.toml"), changed).unwrap();
    task.display().to_string()
}

/// The same with two trials every five steps.
fn train_evaluated(folder: &Path, out: &str) -> Command {
    let mut command = train(folder, out);
    command.args(["--eval-every", "5", "--eval-trials", "2", "--eval-task"]);
    command.arg(hasty_task(folder));
    command
}

fn interrupt(child: &Child) {
    let process = child.id().to_string();
    let sent = Command::new("kill")
        .args(["-INT", &process])
        .status()
        .unwrap();
    assert!(sent.success());
}

#[test]
fn a_training_tells_of_its_steps_from_the_first_on() {
    let folder = scratch("training-told");
    record(&folder.join("data"));
    let output = train(&folder, "out").output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let said = stderr(&output);
    let first = said
        .lines()
        .find(|line| line.starts_with("step 1/12: loss "));
    let first = first.unwrap_or_else(|| panic!("no first step in {said}"));
    assert!(
        first.contains(" samples/s; ") && first.ends_with(" s left"),
        "{first}"
    );
    assert!(said.contains("\nstep 12/12: loss "), "{said}");
    let files = fs::read_dir(folder.join("out")).unwrap();
    let events = files.filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().starts_with("events.out.tfevents.")
    });
    assert_eq!(events.count(), 1);
}

#[test]
fn a_training_of_days_is_warned_of() {
    let folder = scratch("training-days");
    record(&folder.join("data"));
    let mut child = train_steps(&folder, "out", "4000000000000")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let warned = lines.find(|line| line.as_ref().unwrap().contains(" days; "));
    let warned = warned.unwrap().unwrap();
    assert!(
        warned.contains("warning: at ") && warned.contains("--resume"),
        "{warned}"
    );
    interrupt(&child);
    let said: Vec<String> = lines.map(|line| line.unwrap()).collect();
    assert_eq!(child.wait().unwrap().code(), Some(1), "{said:?}");
}

/// Evaluations keep the best weights and change no bit of the training.
#[test]
fn evaluations_keep_the_best_weights() {
    let folder = scratch("training-evaluated");
    record(&folder.join("data"));
    let plain = train(&folder, "plain").output().unwrap();
    assert!(plain.status.success(), "{}", stderr(&plain));
    let result = folder.join("whole.json");
    let whole = train_evaluated(&folder, "whole")
        .arg("--json")
        .arg(&result)
        .output()
        .unwrap();
    assert!(whole.status.success(), "{}", stderr(&whole));
    let result = json(&result);
    assert_eq!(result["evaluations"], 3);
    // None succeeds: of equals the last is kept.
    assert_eq!(result["best"]["step"], 12);
    assert_eq!(result["best"]["trials"], 2);

    // Interrupted in the second evaluation, and once more before the third.
    let mut child = train_evaluated(&folder, "parts")
        .args(["--save-every", "7"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let evaluated = lines.find(|line| {
        let line = line.as_ref().unwrap();
        line.starts_with("step 7: state kept")
    });
    assert!(evaluated.is_some());
    interrupt(&child);
    let said: Vec<String> = lines.map(|line| line.unwrap()).collect();
    let said = said.join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(1), "{said}");
    let parts = folder.join("parts");
    assert!(parts.join("best/model.safetensors").is_file());
    assert!(!parts.join("best.part").exists());
    let resumed = trocar()
        .args(["train", "--resume"])
        .arg(&parts)
        .output()
        .unwrap();
    assert!(resumed.status.success(), "{}", stderr(&resumed));

    let bytes = |run: &str, name: &str| fs::read(folder.join(run).join(name)).unwrap();
    for name in ["model.safetensors", "statistics.safetensors", "loss.csv"] {
        assert!(bytes("plain", name) == bytes("whole", name), "{name}");
        assert!(bytes("parts", name) == bytes("whole", name), "{name}");
    }
    for name in [
        "evaluations.csv",
        "best/evaluation.json",
        "best/model.safetensors",
    ] {
        assert!(bytes("parts", name) == bytes("whole", name), "{name}");
    }
    assert!(
        bytes("whole", "best/model.safetensors") == bytes("whole", "model.safetensors"),
        "the last weights are the best"
    );
    let table = String::from_utf8(bytes("whole", "evaluations.csv")).unwrap();
    let steps: Vec<&str> = table
        .lines()
        .map(|line| line.split(',').next().unwrap())
        .collect();
    assert_eq!(steps, ["step", "5", "10", "12"]);
}

#[test]
fn evaluations_that_cannot_be_are_refused_before_the_training() {
    let folder = scratch("training-eval-refused");
    record(&folder.join("data"));
    for (arguments, reason) in [
        (&["--eval-trials", "3"][..], "--eval-every"),
        (&["--eval-every", "0"][..], "--eval-every"),
        // Its camera sees more pixels than the recording has.
        (&["--eval-every", "5"][..], "512 by 512 pixels"),
        (
            &["--eval-every", "5", "--eval-task", "tonsils"][..],
            "--eval-task",
        ),
        (
            &["--eval-every", "5", "--eval-task", "needle-handover"][..],
            "has 2 arms, the dataset 1",
        ),
    ] {
        let _absent = fs::remove_dir_all(folder.join("out"));
        let output = train(&folder, "out").args(arguments).output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(reason), "{said}");
    }
}

/// It learns from two datasets, which must be there as they were.
#[test]
fn an_interrupted_training_goes_on_to_the_same_bytes() {
    let folder = scratch("training-interrupted");
    record(&folder.join("data"));
    record_steps(&folder.join("more"), 5);
    let train = |out: &str| {
        let mut command = train(&folder, out);
        command.arg("--data").arg(folder.join("more"));
        command
    };
    let whole = train("whole").output().unwrap();
    assert!(whole.status.success(), "{}", stderr(&whole));
    let said = stderr(&whole);
    assert!(
        said.contains("more: needle-lift, 1 episodes, 5 frames\n2 episodes, 13 frames; 12 steps"),
        "{said}"
    );

    let mut child = train("parts").stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    // The handler is in place before anything is decoded.
    let decoded = lines.find(|line| line.as_ref().unwrap().contains("frames decoded"));
    assert!(decoded.is_some());
    interrupt(&child);
    let said: Vec<String> = lines.map(|line| line.unwrap()).collect();
    let said = said.join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(1), "{said}");
    assert!(
        said.contains("--resume") && said.contains("stopped after step"),
        "{said}"
    );
    let state = folder.join("parts/training_state.safetensors");
    assert!(state.is_file() && !folder.join("parts/model.safetensors").exists());

    let parts = folder.join("parts").display().to_string();
    let resume = || {
        trocar()
            .args(["train", "--resume", &parts])
            .output()
            .unwrap()
    };
    fs::rename(folder.join("more"), folder.join("away")).unwrap();
    record_steps(&folder.join("more"), 6);
    let other = resume();
    assert_eq!(other.status.code(), Some(2), "{}", stderr(&other));
    assert!(
        stderr(&other).contains("begun with another dataset"),
        "{}",
        stderr(&other)
    );
    fs::remove_dir_all(folder.join("more")).unwrap();
    fs::rename(folder.join("away"), folder.join("more")).unwrap();
    let resumed = resume();
    assert!(resumed.status.success(), "{}", stderr(&resumed));
    let bytes = |run: &str, name: &str| fs::read(folder.join(run).join(name)).unwrap();
    for name in [
        "model.safetensors",
        "statistics.safetensors",
        "loss.csv",
        "loss.svg",
    ] {
        assert!(
            bytes("whole", name) == bytes("parts", name),
            "{name} differs"
        );
    }
    assert!(!state.exists(), "there is nothing to go on with");
    let again = resume();
    assert_eq!(again.status.code(), Some(2));
    assert!(
        stderr(&again).contains("has no training_state.safetensors"),
        "{}",
        stderr(&again)
    );
}
