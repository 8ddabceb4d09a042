//! Datasets that tests make up: ours, and others' in LeRobot's v2.1 layout.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, FixedSizeListArray, Float32Array, Int64Array, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use hal::JOINT_COUNT;
use hal::psm::DH;
use parquet::arrow::ArrowWriter;
use serde_json::{Value, json};

use crate::dataset::{ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, FrameRecord};
use crate::import::chain::{PoseNumbers, tip_in_rcm};
use crate::import::{ImportRequest, Mapping};

/// A folder of its own for one test, removed at the end.
pub(super) struct Folder(pub(super) PathBuf);

impl Folder {
    pub(super) fn new(test: &str) -> Self {
        let name = format!("trocar-mapped-{test}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _absent = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(super) fn request(&self, mapping: &str, source: &str) -> ImportRequest {
        ImportRequest {
            mapping: Mapping::read(mapping).unwrap(),
            source: self.0.join(source),
            out: self.0.join("out"),
            task: None,
            split: None,
            fps: None,
            size: None,
            video: None,
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _absent = fs::remove_dir_all(&self.0);
    }
}

/// Joints that move a little from step to step, rad (m).
pub(super) fn joints_of_step(step: usize) -> [f64; JOINT_COUNT] {
    let t = step as f64;
    [
        0.1 + 0.01 * t,
        -0.2 + 0.02 * t,
        0.12 + 0.001 * t,
        -0.6 + 0.05 * t,
        0.3 - 0.02 * t,
        -0.25 + 0.03 * t,
    ]
}

fn pose_of_step(step: usize) -> [f64; 7] {
    PoseNumbers::default().of(&tip_in_rcm(&DH, &joints_of_step(step)))
}

/// Records episodes of ours, with poses that are those of the joints.
pub(super) fn record(dir: &Path, arms: usize, cameras: &[&str], lens: &[usize]) {
    let camera = |name: &&str| CameraSpec {
        name: (*name).to_owned(),
        width: 16,
        height: 12,
        depth: None,
    };
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms,
        task: "Lift the needle".to_owned(),
        cameras: cameras.iter().map(camera).collect(),
        intervention: false,
    };
    let mut writer = DatasetWriter::create(dir, &spec).unwrap();
    for (episode, &len) in lens.iter().enumerate() {
        for step in 0..len {
            let arm = |arm: usize| {
                let at = 3 * episode + step + 4 * arm;
                let joints = joints_of_step(at);
                let mut state = [0.4; 7];
                state[..6].copy_from_slice(&joints.map(|joint| joint as f32));
                let mut action = [0.3; 8];
                action[..7].copy_from_slice(&pose_of_step(at + 1));
                ArmFrame {
                    state,
                    tip_pose: pose_of_step(at),
                    action,
                }
            };
            let arms: Vec<ArmFrame> = (0..arms).map(arm).collect();
            let image = vec![(20 * episode + 5 * step) as u8; 16 * 12 * 3];
            let frame = FrameRecord {
                arms: &arms,
                images: &vec![image.as_slice(); cameras.len()],
                depth: &[],
            };
            writer.push_frame(&frame).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}

/// A feature's name, width and rows.
pub(super) type Column = (String, usize, Vec<f64>);

/// State and action of psm1 in Open-H's form, `steps` rows.
pub(super) fn numbers_of(steps: usize) -> Vec<Column> {
    let row = |step: usize| [pose_of_step(step).as_slice(), &[0.2]].concat();
    let rows = |from: usize| (from..from + steps).flat_map(row).collect();
    vec![
        ("observation.state".to_owned(), 8, rows(0)),
        ("action".to_owned(), 8, rows(1)),
    ]
}

/// Another's dataset, an episode a file, each with the same numbers.
pub(super) struct Made {
    pub(super) fps: u32,
    /// Frames that `episodes.jsonl` says each has.
    pub(super) episodes: Vec<usize>,
    pub(super) columns: Vec<Column>,
    pub(super) timestamps: Vec<f64>,
    pub(super) tasks: Vec<&'static str>,
    pub(super) task_of: Vec<usize>,
    pub(super) splits: Value,
    /// Names of the numbers in state and action.
    pub(super) names: [Vec<String>; 2],
}

impl Made {
    /// One episode of `steps` frames.
    pub(super) fn new(steps: usize) -> Self {
        let names = |pose: &str, jaw: &str| {
            let axes = ["x", "y", "z"].map(|axis| format!("psm1_{pose}.position.{axis}"));
            let parts = ["x", "y", "z", "w"].map(|axis| format!("psm1_{pose}.orientation.{axis}"));
            [axes.as_slice(), &parts, &[format!("psm1_{jaw}")]].concat()
        };
        Self {
            fps: 25,
            episodes: vec![steps],
            columns: numbers_of(steps),
            timestamps: Vec::new(),
            tasks: vec!["Lift"],
            task_of: vec![0],
            splits: json!({"train": "0:1"}),
            names: [names("pose", "jaw"), names("sp", "jaw_sp")],
        }
    }

    pub(super) fn write(&self, dir: &Path) {
        fs::create_dir_all(dir.join("meta")).unwrap();
        fs::create_dir_all(dir.join("data/chunk-000")).unwrap();
        let lines = |values: Vec<Value>| {
            let lines: Vec<String> = values.iter().map(Value::to_string).collect();
            lines.join("\n") + "\n"
        };
        let tasks = self.tasks.iter().enumerate();
        let tasks = tasks.map(|(index, task)| json!({"task_index": index, "task": task}));
        fs::write(dir.join("meta/tasks.jsonl"), lines(tasks.collect())).unwrap();
        let episodes = self.episodes.iter().enumerate();
        let episodes = episodes.map(|(index, len)| json!({"episode_index": index, "length": len}));
        fs::write(dir.join("meta/episodes.jsonl"), lines(episodes.collect())).unwrap();
        fs::write(dir.join("meta/info.json"), self.info().to_string()).unwrap();
        for (index, &task) in self.task_of.iter().enumerate() {
            let path = format!("data/chunk-000/episode_{index:06}.parquet");
            self.write_rows(&dir.join(path), index, task);
        }
    }

    fn info(&self) -> Value {
        let mut features = serde_json::Map::new();
        for (name, width, _) in &self.columns {
            let names = match name.as_str() {
                // As Open-H's converter has them: a list in a list.
                "observation.state" => json!([self.names[0]]),
                "action" => json!([self.names[1]]),
                _ => Value::Null,
            };
            let feature = json!({"dtype": "float32", "shape": [width], "names": names});
            features.insert(name.clone(), feature);
        }
        if !self.timestamps.is_empty() {
            let feature = json!({"dtype": "float32", "shape": [1], "names": null});
            features.insert("timestamp".to_owned(), feature);
        }
        let (episodes, frames) = (self.episodes.len(), self.episodes.iter().sum::<usize>());
        json!({
            "codebase_version": "v2.1", "robot_type": "dvrk", "total_episodes": episodes,
            "total_frames": frames, "total_tasks": self.tasks.len(), "chunks_size": 1000,
            "fps": self.fps, "splits": self.splits, "features": features,
            "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
            "video_path": null,
        })
    }

    fn write_rows(&self, path: &Path, episode: usize, task: usize) {
        let mut fields = Vec::new();
        let mut columns: Vec<ArrayRef> = Vec::new();
        let mut rows = usize::MAX;
        for (name, width, values) in &self.columns {
            let item = Arc::new(Field::new_list_field(DataType::Float32, true));
            let numbers = Float32Array::from_iter_values(values.iter().map(|&value| value as f32));
            let (size, numbers) = (*width as i32, Arc::new(numbers));
            columns.push(Arc::new(FixedSizeListArray::new(
                item.clone(),
                size,
                numbers,
                None,
            )));
            fields.push(Field::new(name, DataType::FixedSizeList(item, size), true));
            rows = rows.min(values.len() / width);
        }
        if !self.timestamps.is_empty() {
            let times = self.timestamps.iter().map(|&time| time as f32);
            columns.push(Arc::new(Float32Array::from_iter_values(times)));
            fields.push(Field::new("timestamp", DataType::Float32, true));
        }
        for (name, value) in [("episode_index", episode), ("task_index", task)] {
            columns.push(Arc::new(Int64Array::from(vec![value as i64; rows])));
            fields.push(Field::new(name, DataType::Int64, true));
        }
        let schema = Arc::new(Schema::new(fields));
        let batch = RecordBatch::try_new(Arc::clone(&schema), columns).unwrap();
        let file = fs::File::create(path).unwrap();
        let mut writer = ArrowWriter::try_new(file, schema, None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
    }
}
