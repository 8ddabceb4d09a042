//! The binary on demonstrations in HDF5: a dataset with the controller's own kinematics in it, or exit code 2 with the reason.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;
use std::process::Output;

use hal::{JointVector, TipTarget};
use tests::{Profile, json, repository, scratch, stderr, trocar};
use trocar_control::kinematics::forward;
use trocar_data::dataset::Dataset;

/// Imports the folder or file `source` of those that h5py wrote.
fn import(layout: &str, source: &str, out: &Path, more: &[&str]) -> Output {
    let source = repository().join("policy/data/tests/hdf5").join(source);
    trocar(Profile::Debug)
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
