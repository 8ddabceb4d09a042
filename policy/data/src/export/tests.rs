//! Small datasets in Open-H-Embodiment's form, read again as LeRobot reads v2.1; what can't be
//! exported is refused.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "steps and grey values of a test are small numbers"
)]

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::*;
use crate::dataset::{ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, FrameRecord};

/// A folder of its own for one test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let name = format!("trocar-export-{test}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _absent = fs::remove_dir_all(&path);
        Self(path)
    }

    fn options(&self) -> ExportOptions {
        ExportOptions {
            dataset: self.0.join("ours"),
            failures: None,
            out: self.0.join("theirs"),
            instruction: None,
            tools: vec!["Large Needle Driver".to_owned()],
            video: VideoCodec::H264,
            provenance: Provenance::default(),
        }
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.0.join("theirs").join(name)).unwrap()
    }

    fn lines(&self, name: &str) -> Vec<Value> {
        let text = self.text(name);
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _absent = fs::remove_dir_all(&self.0);
    }
}

fn camera(name: &str) -> CameraSpec {
    CameraSpec {
        name: name.to_owned(),
        width: 16,
        height: 12,
        depth: None,
    }
}

fn spec(arms: usize, cameras: &[&str]) -> DatasetSpec {
    DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms,
        task: "Lift the needle".to_owned(),
        cameras: cameras.iter().map(|name| camera(name)).collect(),
        intervention: false,
    }
}

/// Records episodes of `lens` frames with the notes that they come with.
fn record(dir: &Path, spec: &DatasetSpec, lens: &[usize], notes: &[Value]) {
    let mut writer = DatasetWriter::create(dir, spec).unwrap();
    for (episode, &len) in lens.iter().enumerate() {
        for step in 0..len {
            let along = 1e-3 * (10 * episode + step) as f64;
            let arm = |arm: usize| ArmFrame {
                state: [0.1, 0.2, 0.1, 0.3, 0.0, 0.0, 0.5 + arm as f32],
                tip_pose: [along, arm as f64, -0.1, 0.0, 0.6, 0.0, 0.8],
                action: [along + 1e-3, arm as f64, -0.1, 0.0, 0.6, 0.0, 0.8, 0.25],
            };
            let arms: Vec<ArmFrame> = (0..spec.arms).map(arm).collect();
            let image = vec![(20 * episode + step) as u8; 16 * 12 * 3];
            let images = vec![image.as_slice(); spec.cameras.len()];
            let frame = FrameRecord {
                arms: &arms,
                images: &images,
                depth: &[],
            };
            writer.push_frame(&frame).unwrap();
        }
        writer.end_episode_with(notes[episode].clone()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn two_arms_have_the_fields_names_order_and_units() {
    let folder = Folder::new("two");
    let spec = spec(2, &["endoscope", "wrist_right", "wrist_left", "side"]);
    let disturbed = json!({"disturbances": [{"kind": "slip"}]});
    let notes = [disturbed, json!({"disturbances": null})];
    record(&folder.0.join("ours"), &spec, &[3, 2], &notes);
    let summary = export_open_h(&folder.options(), &mut |_, _| {}).unwrap();
    assert_eq!((summary.arms, summary.episodes, summary.frames), (2, 2, 5));
    assert_eq!(summary.splits["perfect"], "0:1");
    assert_eq!(summary.splits["recovery"], "1:2");
    assert_eq!(summary.warnings.len(), 4, "{:?}", summary.warnings);
    let info: Value = serde_json::from_str(&folder.text("meta/info.json")).unwrap();
    assert_eq!(info["codebase_version"], "v2.1");
    assert_eq!(
        (&info["robot_type"], &info["total_videos"]),
        (&json!("dvrk"), &json!(8))
    );
    let names = info["features"]["observation.state"]["names"]
        .as_array()
        .unwrap();
    assert_eq!(names.len(), 16);
    assert_eq!(names[0], "psm1_pose.position.x");
    assert_eq!(names[15], "psm2_jaw");
    assert_eq!(
        info["features"]["action"]["names"][6],
        "psm1_sp.orientation.w"
    );
    for camera in ["endoscope.left", "wrist.left", "wrist.right", "side"] {
        let feature = format!("observation.images.{camera}");
        assert_eq!(info["features"][&feature]["dtype"], "video", "{feature}");
        let path = format!("videos/chunk-000/{feature}/episode_000001.mp4");
        assert!(folder.0.join("theirs").join(path).is_file());
    }
    // The undisturbed episode of two frames comes first.
    let episodes = folder.lines("meta/episodes.jsonl");
    assert_eq!(
        episodes[0],
        json!({"episode_index": 0, "tasks": ["Lift the needle"], "length": 2})
    );
    let stats = folder.lines("meta/episodes_stats.jsonl");
    let means = &stats[0]["stats"]["observation.state"]["mean"];
    assert!(
        (means[0].as_f64().unwrap() - 0.0105).abs() < 1e-6,
        "{means}"
    );
    assert_eq!(
        stats[1]["stats"]["observation.images.side"]["count"],
        json!([1])
    );
    let readme = folder.text("meta/README.md");
    assert!(
        readme.contains("synchron") && readme.contains("CC BY 4.0"),
        "{readme}"
    );
}

/// They come last whatever is noted of them, in no split but `failure`, and the page says which
/// they are.
#[test]
fn failures_are_a_split_of_their_own() {
    let folder = Folder::new("failures");
    let spec = spec(1, &["wrist"]);
    let (plain, why) = (
        json!({"failure": false}),
        json!({"failure": "time ran out"}),
    );
    let slip = json!({"disturbances": [{"kind": "slip"}]});
    record(&folder.0.join("ours"), &spec, &[3, 2], &[slip, plain]);
    record(
        &folder.0.join("failed"),
        &spec,
        &[4, 1],
        &[why, Value::Null],
    );
    let options = ExportOptions {
        failures: Some(folder.0.join("failed")),
        ..folder.options()
    };
    let summary = export_open_h(&options, &mut |_, _| {}).unwrap();
    assert_eq!((summary.episodes, summary.frames), (4, 10));
    let info: Value = serde_json::from_str(&folder.text("meta/info.json")).unwrap();
    let splits = json!({
        "val": "0:0", "test": "0:0", "train": "0:2", "perfect": "0:1", "recovery": "1:2", "failure": "2:4",
    });
    assert_eq!(info["splits"], splits);
    let lens: Vec<Value> = folder.lines("meta/episodes.jsonl");
    let lens: Vec<&Value> = lens.iter().map(|line| &line["length"]).collect();
    assert_eq!(lens, [2, 3, 4, 1]);
    let readme = folder.text("meta/README.md");
    assert!(readme.contains("Failures: episodes 2 to 3: "), "{readme}");

    let other = Folder::new("failures-apart");
    let wider = DatasetSpec { fps: 50, ..spec };
    record(&other.0.join("failed"), &wider, &[1], &[Value::Null]);
    let options = ExportOptions {
        failures: Some(other.0.join("failed")),
        out: other.0.join("theirs"),
        ..folder.options()
    };
    let told = export_open_h(&options, &mut |_, _| {}).unwrap_err();
    assert!(
        told.to_string().contains("fps is 25 in the first"),
        "{told}"
    );
    assert!(!options.out.exists());
}

#[test]
fn rows_are_those_of_the_dataset() {
    let folder = Folder::new("rows");
    let spec = spec(1, &["wrist"]);
    record(
        &folder.0.join("ours"),
        &spec,
        &[3],
        &[json!({"instruction": "Grasp"})],
    );
    export_open_h(&folder.options(), &mut |_, _| {}).unwrap();
    let out = folder.0.join("theirs");
    let feature = "observation.images.wrist.right".to_owned();
    let mut read = crate::dataset::foreign::Foreign::open(&out, &[feature]).unwrap();
    let (width, states) = read.numbers(0, "observation.state").unwrap();
    assert_eq!(width, 8);
    let expected = [0.002, 0.0, -0.1, 0.0, 0.6, 0.0, 0.8, 0.5];
    for (found, expected) in states[16..].iter().zip(expected) {
        assert!((found - expected).abs() < 1e-7, "{states:?}");
    }
    let (width, joints) = read.numbers(0, names::JOINTS).unwrap();
    assert_eq!((width, joints.len()), (6, 18));
    assert_eq!(read.texts(0, names::INSTRUCTION).unwrap(), ["Grasp"; 3]);
    assert_eq!(read.tasks(0).unwrap(), ["Grasp"; 3]);
    let tool = read.texts(0, "observation.meta.tool.psm1").unwrap();
    assert_eq!(tool[0], "Large Needle Driver");
    let image = read.rgb(0, 2, 0).unwrap();
    assert!(image.pixels().all(|pixel| pixel.0[0].abs_diff(2) <= 2));
}

#[test]
fn what_can_not_be_exported_is_refused() {
    let refused = |name: &str, spec: &DatasetSpec, expected: &str| {
        let folder = Folder::new(name);
        record(&folder.0.join("ours"), spec, &[1], &[Value::Null]);
        let error = export_open_h(&folder.options(), &mut |_, _| {}).unwrap_err();
        let told = error.to_string();
        assert!(told.contains(expected), "no {expected:?} in: {told}");
        assert!(!folder.0.join("theirs").exists());
    };
    refused("blind", &spec(1, &[]), "meta/info.json: a camera");
    refused(
        "twice",
        &spec(1, &["endoscope", "endoscope_left"]),
        "another observation.images.endoscope.left",
    );
    let mut odd = spec(1, &["endoscope"]);
    odd.cameras[0].width = 15;
    odd.cameras[0].height = 12;
    let folder = Folder::new("odd");
    let mut writer = DatasetWriter::create(&folder.0.join("ours"), &odd).unwrap();
    let arm = ArmFrame {
        state: [0.0; 7],
        tip_pose: [0.0; 7],
        action: [0.0; 8],
    };
    let image = vec![0; 15 * 12 * 3];
    let frame = FrameRecord {
        arms: &[arm],
        images: &[&image],
        depth: &[],
    };
    writer.push_frame(&frame).unwrap();
    writer.end_episode().unwrap();
    let told = export_open_h(&folder.options(), &mut |_, _| {})
        .unwrap_err()
        .to_string();
    assert!(
        told.contains("15 x 12") && told.contains("even sides"),
        "{told}"
    );
}

#[test]
fn a_folder_in_use_is_left_alone() {
    let folder = Folder::new("used");
    record(
        &folder.0.join("ours"),
        &spec(1, &["wrist"]),
        &[1],
        &[Value::Null],
    );
    fs::create_dir_all(folder.0.join("theirs")).unwrap();
    fs::write(folder.0.join("theirs/mine"), "kept").unwrap();
    let error = export_open_h(&folder.options(), &mut |_, _| {}).unwrap_err();
    assert!(matches!(error, DatasetError::Exists { .. }), "{error}");
    assert_eq!(folder.text("mine"), "kept");
}
