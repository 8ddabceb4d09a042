//! The binary on demonstrations of others, and in others' form: a dataset with the controller's own
//! kinematics in it, or exit code 2 with the reason.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;
use std::process::Output;

use hal::{JointVector, TipTarget};
use tests::{json, repository, scratch, stderr, trocar};
use trocar_control::kinematics::forward;
use trocar_data::dataset::Dataset;

/// Imports the folder or file `source` of those that h5py wrote.
fn import(layout: &str, source: &str, out: &Path, more: &[&str]) -> Output {
    let source = repository().join("policy/data/tests/hdf5").join(source);
    trocar()
        .args(["import", layout])
        .arg(source)
        .args(["--fps", "25", "--task", "Lift the needle", "--out"])
        .arg(out)
        .args(more)
        .output()
        .unwrap()
}

#[test]
fn imported_joints_have_the_controllers_poses() {
    let folder = scratch("import");
    let (out, result) = (folder.join("demos"), folder.join("import.json"));
    let done = import("act", "act", &out, &["--json", result.to_str().unwrap()]);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let told = String::from_utf8_lossy(&done.stdout);
    assert!(told.starts_with("1 episodes, 4 frames in "), "{told}");
    let expected = serde_json::json!({"arms": 1, "cameras": ["top"], "episodes": 1, "frames": 4});
    assert_eq!(json(&result), expected);
    let dataset = Dataset::open(&out).unwrap();
    assert_eq!(dataset.len(), 4);
    for frame in 0..dataset.len() {
        let state = dataset.state(frame, 0).map(f64::from);
        let pose = forward(&JointVector::from_column_slice(&state[..6]));
        let meant = TipTarget::new(&pose, 0.0).pose_numbers();
        let found = dataset.tip_pose(frame, 0);
        let inner: f64 = (3..7).map(|part| found[part] * meant[part]).sum();
        let apart = (0..3).map(|axis| (found[axis] - meant[axis]).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-12, "{found:?} {meant:?}");
        assert!((inner.abs() - 1.0).abs() < 1e-12, "{found:?} {meant:?}");
    }
}

#[test]
fn what_can_not_be_imported_ends_with_code_2_and_the_reason() {
    let folder = scratch("import-refused");
    let used = folder.join("used");
    fs::create_dir_all(&used).unwrap();
    fs::write(used.join("file"), "").unwrap();
    let chain = folder.join("arm.json");
    fs::write(&chain, "[[0, 0, 0, 0, false]]").unwrap();
    let new = folder.join("new");
    let dh = ["--dh", chain.to_str().unwrap()];
    let delta = [
        "--joints",
        "obs/joint_pos",
        "--images",
        "obs/scope_image",
        "--action-pose",
        "actions",
    ];
    let cases: [(&str, &str, &Path, &[&str], &str); 5] = [
        ("act", "act", &used, &[], "--out"),
        ("act", "act", &new, &dh, "arm.json: has 1 rows, expected 6"),
        ("act", "nowhere", &new, &[], "nowhere: cannot be read"),
        (
            "robomimic",
            "robomimic.hdf5",
            &new,
            &[],
            "--joints, --images",
        ),
        (
            "robomimic",
            "robomimic.hdf5",
            &new,
            &delta,
            "robomimic.hdf5, data/demo_0: actions has 14 numbers a step, expected 8",
        ),
    ];
    for (layout, source, out, more, expected) in cases {
        let refused = import(layout, source, out, more);
        let message = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.contains(expected), "no {expected:?} in: {message}");
    }
}

/// Records two frames of one arm, whose poses are the controller's own, at `dir`.
fn record(dir: &Path) {
    use trocar_data::dataset::{ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, FrameRecord};
    let camera = CameraSpec {
        name: "endoscope".to_owned(),
        width: 32,
        height: 32,
        depth: None,
    };
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "Lift the needle".to_owned(),
        cameras: vec![camera],
        intervention: false,
    };
    let mut writer = DatasetWriter::create(dir, &spec).unwrap();
    for step in 0..2 {
        let joints = [0.2, -0.1, 0.13, 0.4 + 0.1 * f64::from(step), -0.5, 0.6];
        let pose = forward(&JointVector::from_column_slice(&joints));
        let mut state = [0.3; 7];
        for (to, from) in state.iter_mut().zip(joints) {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a dataset's joints are f32"
            )]
            let from = from as f32;
            *to = from;
        }
        let tip_pose = TipTarget::new(&pose, 0.0).pose_numbers();
        let mut action = [0.25; 8];
        action[..7].copy_from_slice(&tip_pose);
        let arms = [ArmFrame {
            state,
            tip_pose,
            action,
        }];
        let image = vec![90; 3 * 32 * 32];
        let frame = FrameRecord {
            arms: &arms,
            images: &[&image],
            depth: &[],
        };
        writer.push_frame(&frame).unwrap();
    }
    writer.end_episode().unwrap();
    writer.finish().unwrap();
}

/// What goes out in Open-H's form comes in again, with joints from the poses that are those of the
/// controller's kinematics.
#[test]
fn open_h_goes_out_and_comes_in() {
    let folder = scratch("import-open-h");
    let [ours, theirs, back] = ["ours", "theirs", "back"].map(|name| folder.join(name));
    record(&ours);
    let run = |arguments: &[&str], source: &Path, out: &Path| {
        let mut command = trocar();
        command.args(arguments).arg(source).arg("--out").arg(out);
        command.output().unwrap()
    };
    let done = run(&["export", "open-h"], &ours, &theirs);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    assert!(
        stderr(&done).contains("endoscope has 32 x 32 pixels"),
        "{}",
        stderr(&done)
    );
    let told = String::from_utf8_lossy(&done.stdout);
    assert!(told.starts_with("1 episodes, 2 frames in "), "{told}");
    let again = run(&["export", "open-h"], &ours, &theirs);
    assert_eq!(again.status.code(), Some(2), "{}", stderr(&again));
    let import = ["import", "lerobot", "--mapping", "open-h-dvrk"];
    let done = run(&import, &theirs, &back);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let (found, meant) = (Dataset::open(&back).unwrap(), Dataset::open(&ours).unwrap());
    for (frame, joint) in (0..2).flat_map(|frame| (0..7).map(move |joint| (frame, joint))) {
        let apart = found.state(frame, 0)[joint] - meant.state(frame, 0)[joint];
        assert!(apart.abs() < 2e-5, "{frame} {joint}: {apart}");
    }
    for (mapping, expected) in [
        (
            "my-robot",
            "--mapping my-robot: is no file, and built in are open-h-dvrk, dvrk-raw",
        ),
        (
            "dvrk-raw",
            "has no tissue_N/K_SUBTASK/episode_NNN/ee_csv.csv",
        ),
    ] {
        let import = ["import", "lerobot", "--mapping", mapping];
        let refused = run(&import, &theirs, &folder.join("new"));
        let message = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.contains(expected), "no {expected:?} in: {message}");
    }
}

/// Runs a needle lift in lockstep with pictures of 64 x 64 into `log`.
fn lift(folder: &Path, seed: &str, log: &Path) {
    let shipped = repository().join("config/tasks/needle-lift/scene.toml");
    let scene = fs::read_to_string(shipped).unwrap();
    let small = folder.join("small.toml");
    fs::write(&small, scene.replace("= 512", "= 64")).unwrap();
    let ran = trocar()
        .args(["run", "--task", "needle-lift", "--policy", "expert"])
        .args(["--lockstep", "--seed", seed, "--scene"])
        .arg(&small)
        .arg("--log")
        .arg(log)
        .output()
        .unwrap();
    assert_eq!(ran.status.code(), Some(0), "{}", stderr(&ran));
}

/// Logs become a dataset that a network learns from.
#[test]
fn logs_of_runs_become_a_dataset_to_train_on() {
    let folder = scratch("import-log");
    let [first, second] = ["a.mcap", "b.mcap"].map(|name| folder.join(name));
    lift(&folder, "7", &first);
    lift(&folder, "8", &second);
    let (out, result) = (folder.join("demos"), folder.join("import.json"));
    let import = |logs: &[&Path], more: &[&str]| {
        let mut command = trocar();
        command.args(["import", "log"]).args(logs).args(more);
        command
            .args(["--task", "Lift the needle", "--out"])
            .arg(&out);
        command.output().unwrap()
    };
    for (logs, more, expected) in [
        (&[first.as_path(); 2][..], &[][..], "a.mcap: is given twice"),
        (
            &[&first, &folder.join("./a.mcap")],
            &[],
            "a.mcap: is given twice",
        ),
        (
            &[&first],
            &["--fps", "50"],
            "a.mcap: too few frames of endoscope for --fps 50: it has 25.",
        ),
        (
            &[&first],
            &["--cameras", "wrist"],
            "a.mcap: has no frames of wrist, only of endoscope",
        ),
        (
            &[&folder.join("small.toml")],
            &[],
            "small.toml: not an MCAP file",
        ),
    ] {
        let refused = import(logs, more);
        let message = stderr(&refused);
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.contains(expected), "no {expected:?} in: {message}");
    }
    let size = ["--resize", "256x256", "--json", result.to_str().unwrap()];
    let done = import(&[&first, &second], &size);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let told = String::from_utf8_lossy(&done.stdout);
    assert!(told.starts_with("2 episodes, "), "{told}");
    let found = json(&result);
    let dataset = Dataset::open(&out).unwrap();
    assert_eq!(found["frames"], dataset.len());
    let expected = serde_json::json!({
        "arms": 1, "cameras": ["endoscope"], "episodes": 2, "frames": dataset.len(), "by_hand": 0, "left_out": 0,
        "discarded": [],
    });
    assert_eq!(found, expected);
    let trained = trocar()
        .args([
            "train", "--policy", "act", "--preset", "small", "--steps", "2", "--batch", "2",
        ])
        .args(["--threads", "1", "--data"])
        .arg(&out)
        .arg("--out")
        .arg(folder.join("act"))
        .output()
        .unwrap();
    assert_eq!(trained.status.code(), Some(0), "{}", stderr(&trained));
    assert!(folder.join("act/model.safetensors").exists());
}
