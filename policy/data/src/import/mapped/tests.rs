//! Datasets of others by a table of names: what comes in is what was there, and what can't be meant
//! is refused by name.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "steps and grey values of a test are small numbers"
)]

mod made;
mod raw;
mod refused;

use std::fs;

use hal::psm::{DEGREE, DH};
use hal::{JOINT_COUNT, Pose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde_json::json;

use self::made::{Folder, Made, joints_of_step, numbers_of, record};
use super::super::chain::tip_in_rcm;
use super::*;
use crate::dataset::{Dataset, Notes};
use crate::export::{ExportOptions, export_open_h};

/// Positions come back within the rounding of `f32`, m; quaternions and jaws, too.
const ROUNDING: f64 = 1e-7;
/// Joints come back within what that rounding makes of them, rad (m).
const JOINT_ROUNDING: f32 = 2e-5;

/// Every number of `found` is that of `meant`; of a turn's two quaternions either.
fn assert_same(found: &Dataset, meant: &Dataset) {
    assert_eq!((found.len(), found.arms()), (meant.len(), meant.arms()));
    let near = |a: &[f64], b: &[f64]| {
        let inner: f64 = (3..7).map(|part| a[part] * b[part]).sum();
        let side = inner.signum();
        a.iter().zip(b).enumerate().all(|(place, (a, b))| {
            let side = if (3..7).contains(&place) { side } else { 1.0 };
            (a * side - b).abs() < ROUNDING
        })
    };
    for (frame, arm) in (0..meant.len()).flat_map(|frame| [(frame, 0), (frame, meant.arms() - 1)]) {
        let (a, b) = (found.tip_pose(frame, arm), meant.tip_pose(frame, arm));
        assert!(near(&a, &b), "{frame}: {a:?} {b:?}");
        let (a, b) = (found.action(frame, arm), meant.action(frame, arm));
        assert!(near(&a, &b), "{frame}: {a:?} {b:?}");
        let (a, b) = (found.state(frame, arm), meant.state(frame, arm));
        let apart = a
            .iter()
            .zip(b)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(apart < JOINT_ROUNDING, "{frame}: {a:?} {b:?}");
    }
}

/// What is exported in Open-H's form and imported again is what it was, joints by inverse
/// kinematics included.
#[test]
fn open_h_round_trip_keeps_every_number() {
    for arms in [1, 2] {
        let folder = Folder::new(&format!("round-{arms}"));
        let cameras = match arms {
            1 => vec!["endoscope", "wrist"],
            _ => vec!["endoscope", "wrist_right", "wrist_left"],
        };
        record(&folder.0.join("ours"), arms, &cameras, &[5, 3]);
        let options = ExportOptions {
            dataset: folder.0.join("ours"),
            failures: None,
            out: folder.0.join("theirs"),
            instruction: None,
            tools: vec!["Large Needle Driver".to_owned()],
            video: crate::dataset::VideoCodec::H264,
            provenance: crate::export::Provenance::default(),
        };
        export_open_h(&options, &mut |_, _| {}).unwrap();
        let request = folder.request("open-h-dvrk", "theirs");
        let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
        assert_eq!(
            (summary.arms, summary.episodes, summary.frames),
            (arms, 2, 8)
        );
        assert_eq!(summary.cameras, cameras);
        let (found, meant) = (
            Dataset::open(&request.out).unwrap(),
            Dataset::open(&options.dataset).unwrap(),
        );
        assert_same(&found, &meant);
        assert_eq!(found.spec().task, meant.spec().task);
        let [a, b] = [&found, &meant].map(|dataset| dataset.image_rgb(7, 0).unwrap());
        let apart = a
            .as_raw()
            .iter()
            .zip(b.as_raw())
            .map(|(a, b)| a.abs_diff(*b));
        assert!(apart.max().unwrap() <= 3);
    }
}

/// Millimetres, degrees, w first, indices in place of names, a tool tip, and another frame than the
/// arm's.
#[test]
fn units_order_frame_and_tool_tip_are_the_mappings() {
    let folder = Folder::new("units");
    let rcm_in_source = Pose::from_parts(
        Translation3::new(0.3, -0.1, 0.2),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.4, 0.8, -0.2)),
    );
    let tool_tip = Translation3::new(0.0, 0.0, 0.0102);
    let row = |step: usize| {
        let joints = joints_of_step(step);
        let tip = rcm_in_source * tip_in_rcm(&DH, &joints) * tool_tip;
        let (at, turn) = (tip.translation.vector * 1e3, tip.rotation.coords);
        let degrees = 20.0 + step as f64;
        [at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z, degrees]
    };
    let mut made = Made::new(4);
    made.fps = 30;
    made.columns = vec![("arm".to_owned(), 8, (0..4).flat_map(row).collect())];
    made.write(&folder.0.join("theirs"));
    let coords = rcm_in_source.rotation.coords;
    let mapping = format!(
        "format = \"lerobot\"\nlength_unit = \"mm\"\nangle_unit = \"deg\"\nquaternion = \"wxyz\"\n\
         tip_beyond_wrist_m = 0.0102\n[[arms]]\n\
         tip_position = {{ feature = \"arm\", indices = [0, 1, 2] }}\n\
         tip_orientation = {{ feature = \"arm\", indices = [3, 4, 5, 6] }}\n\
         jaw = {{ feature = \"arm\", indices = [7] }}\n\
         action_position = {{ feature = \"arm\", indices = [0, 1, 2] }}\n\
         action_orientation = {{ feature = \"arm\", indices = [3, 4, 5, 6] }}\n\
         action_jaw = {{ feature = \"arm\", indices = [7] }}\n\
         rcm_in_source = {{ position_m = [0.3, -0.1, 0.2], orientation_xyzw = [{}, {}, {}, {}] }}\n",
        coords.x, coords.y, coords.z, coords.w
    );
    let path = folder.0.join("my.toml");
    fs::write(&path, mapping).unwrap();
    let request = folder.request(path.to_str().unwrap(), "theirs");
    import_mapped(&request, &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&request.out).unwrap();
    assert_eq!((dataset.fps(), dataset.camera_names().len()), (30, 0));
    for step in 0..4 {
        let joints = joints_of_step(step);
        let state = dataset.state(step, 0).map(f64::from);
        for joint in 0..JOINT_COUNT {
            let apart = (state[joint] - joints[joint]).abs();
            assert!(apart < 2e-5, "{state:?} {joints:?}");
        }
        let jaw = (20.0 + step as f64) * DEGREE;
        assert!((state[6] - jaw).abs() < 1e-6);
        let meant = tip_in_rcm(&DH, &joints).translation.vector;
        let found = dataset.action(step, 0);
        for axis in 0..3 {
            assert!(
                (found[axis] - meant[axis]).abs() < 2e-7,
                "{found:?} {meant:?}"
            );
        }
    }
}

/// Where joints are there, they are taken; poses follow by forward kinematics where they are not.
#[test]
fn joints_are_taken_and_poses_follow() {
    let folder = Folder::new("joints");
    let row = |step: usize| {
        let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw] = joints_of_step(step);
        [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, 0.25]
    };
    let mut made = Made::new(3);
    made.columns = vec![("q".to_owned(), 7, (0..3).flat_map(row).collect())];
    made.write(&folder.0.join("theirs"));
    let mapping = "format = \"lerobot\"\nlength_unit = \"m\"\nangle_unit = \"rad\"\nquaternion = \"xyzw\"\n\
         tip_beyond_wrist_m = 0.0\n[[arms]]\n\
         joints = { feature = \"q\", indices = [0, 1, 2, 3, 4, 5] }\njaw = { feature = \"q\", indices = [6] }\n\
         action_joints = { feature = \"q\", indices = [0, 1, 2, 3, 4, 5] }\naction_jaw = { feature = \"q\", indices = [6] }\n";
    let path = folder.0.join("my.toml");
    fs::write(&path, mapping).unwrap();
    let request = folder.request(path.to_str().unwrap(), "theirs");
    import_mapped(&request, &mut |_, _| {}).unwrap();
    let dataset = Dataset::open(&request.out).unwrap();
    let joints = joints_of_step(2).map(|joint| f64::from(joint as f32));
    let meant = tip_in_rcm(&DH, &joints).translation.vector;
    let found = dataset.tip_pose(2, 0);
    for axis in 0..3 {
        assert!(
            (found[axis] - meant[axis]).abs() < 1e-9,
            "{found:?} {meant:?}"
        );
    }
}

/// Failures that are exported stay behind on the way back unless they are asked for, and then they
/// are what they were.
#[test]
fn failures_go_out_and_come_in() {
    let folder = Folder::new("failures");
    let (ours, failed) = (folder.0.join("ours"), folder.0.join("failed"));
    record(&ours, 1, &["endoscope"], &[5, 3]);
    record(&failed, 1, &["endoscope"], &[2, 4]);
    let options = ExportOptions {
        dataset: ours.clone(),
        failures: Some(failed.clone()),
        out: folder.0.join("theirs"),
        instruction: None,
        tools: vec!["Large Needle Driver".to_owned()],
        video: crate::dataset::VideoCodec::H264,
        provenance: crate::export::Provenance::default(),
    };
    let summary = export_open_h(&options, &mut |_, _| {}).unwrap();
    assert_eq!(summary.splits["failure"], "2:4");
    let mut request = folder.request("open-h-dvrk", "theirs");
    for (split, meant) in [(None, ours), (Some("failure"), failed)] {
        request.split = split.map(str::to_owned);
        request.out = folder.0.join(split.unwrap_or("back"));
        let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
        assert_eq!((summary.episodes, summary.left_out), (2, 2));
        let (found, meant) = (
            Dataset::open(&request.out).unwrap(),
            Dataset::open(&meant).unwrap(),
        );
        assert_same(&found, &meant);
        assert_eq!(found.episodes(), meant.episodes());
    }
}

/// Episodes of the split failure stay behind unless asked for; recoveries are noted; several
/// instructions need one text.
#[test]
fn splits_and_instructions_are_heeded() {
    let folder = Folder::new("splits");
    let mut made = Made::new(3);
    made.columns = numbers_of(3);
    made.episodes = vec![3, 3, 3];
    made.tasks = vec!["Grasp", "Lift"];
    made.task_of = vec![0, 1, 0];
    made.splits = json!({"train": "0:2", "recovery": "1:2", "failure": "2:3"});
    made.write(&folder.0.join("theirs"));
    let mut request = folder.request("open-h-dvrk", "theirs");
    request.mapping.cameras.clear();
    let told = import_mapped(&request, &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        told.contains("2 instructions (\"Grasp\", \"Lift\")"),
        "{told}"
    );
    request.task = Some("Grasp and lift".to_owned());
    let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
    assert_eq!(
        (summary.episodes, summary.recoveries, summary.left_out),
        (2, 1, 1)
    );
    let notes = Notes::read(&request.out).unwrap().episodes;
    assert_eq!(
        (&notes[1]["instruction"], &notes[1]["recovery"]),
        (&json!("Lift"), &json!(true))
    );
    request.split = Some("failure".to_owned());
    request.task = None;
    request.out = folder.0.join("failures");
    let summary = import_mapped(&request, &mut |_, _| {}).unwrap();
    assert_eq!(
        (summary.episodes, summary.instructions),
        (1, vec!["Grasp".to_owned()])
    );
    let notes = Notes::read(&request.out).unwrap().episodes;
    let failed = |note: &serde_json::Value| note["failure"].clone();
    assert_eq!(failed(&notes[0]), json!(true));
    request.split = Some("expert".to_owned());
    request.out = folder.0.join("none");
    let told = import_mapped(&request, &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        told.contains("--split expert") && told.contains("failure, recovery, train"),
        "{told}"
    );
}
