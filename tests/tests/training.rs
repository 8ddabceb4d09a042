//! A training in a process of its own that is interrupted keeps its state, and ends with the bytes of one that was not.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use hal::Intrinsics;
use policy::dataset::{ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, DepthFrame, FrameRecord};
use tests::{Profile, scratch, stderr, trocar};

const SIDE: u32 = 16;
const PIXELS: usize = (SIDE * SIDE) as usize;

/// One episode of a needle that comes nearer, seen by one camera with depth.
fn record(folder: &Path) {
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
    };
    let mut writer = DatasetWriter::create(folder, &spec).unwrap();
    for step in 0..8_u16 {
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
    let path = |name: &str| folder.join(name).display().to_string();
    let clouds =
        "frame = \"scene\"\ndropped_instances = [0]\npoints = 32\npadding = \"first_point\"\n";
    fs::write(path("clouds.toml"), clouds).unwrap();
    let mut command = trocar(Profile::Debug);
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
        "12",
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

#[test]
fn an_interrupted_training_goes_on_to_the_same_bytes() {
    let folder = scratch("training-interrupted");
    record(&folder.join("data"));
    let whole = train(&folder, "whole").output().unwrap();
    assert!(whole.status.success(), "{}", stderr(&whole));

    let mut child = train(&folder, "parts")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    // The handler is in place before anything is decoded.
    let decoded = lines.find(|line| line.as_ref().unwrap().contains("frames decoded"));
    assert!(decoded.is_some());
    let process = child.id().to_string();
    let sent = Command::new("kill")
        .args(["-INT", &process])
        .status()
        .unwrap();
    assert!(sent.success());
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
        trocar(Profile::Debug)
            .args(["train", "--resume", &parts])
            .output()
            .unwrap()
    };
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
