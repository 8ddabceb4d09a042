//! A dataset that is written, cut off or damaged, and read again.

mod joined;
mod refused;
mod two_arms;

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use super::{
    ArmFrame, CameraSpec, Dataset, DatasetError, DatasetSpec, DatasetWriter, FrameRecord, Totals,
    meta, schema,
};

/// A folder of its own for one test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("trocar-dataset-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const LENGTHS: [usize; 3] = [5, 130, 3];

fn spec() -> DatasetSpec {
    let camera = |name: &str, width, height| CameraSpec {
        name: name.to_owned(),
        width,
        height,
        depth: None,
    };
    DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "Lift the needle".to_owned(),
        // Not in alphabetical order: the order of the specification has to survive.
        cameras: vec![camera("scope", 24, 16), camera("overview", 8, 12)],
        intervention: false,
    }
}

/// Numbers that differ between frames and places and have no short binary form.
fn numbers<const N: usize>(frame: usize, salt: f64) -> [f64; N] {
    let real = |value: usize| f64::from(u32::try_from(value).unwrap());
    std::array::from_fn(|place| (real(frame) + 0.1).sin() * salt + real(place) / 3.0)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "this is what the writer is to do"
)]
fn narrow<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

fn bits<const N: usize>(values: [f64; N]) -> [u64; N] {
    values.map(f64::to_bits)
}

fn image(frame: usize, size: usize) -> Vec<u8> {
    (0..size)
        .map(|place| u8::try_from((frame * 31 + place * place) % 256).unwrap())
        .collect()
}

/// Numbers of an arm; those of the second are others.
fn arm(frame: usize, arm: usize) -> ArmFrame {
    let salted = |salt: f64| if arm == 0 { salt } else { -salt };
    ArmFrame {
        state: narrow(numbers(frame, salted(0.5))),
        tip_pose: numbers(frame, salted(0.05)),
        action: numbers(frame, salted(0.06)),
    }
}

const STILL: ArmFrame = ArmFrame {
    state: [0.0; 7],
    tip_pose: [0.0; 7],
    action: [0.0; 8],
};

fn push(writer: &mut DatasetWriter, frame: usize) -> Result<(), DatasetError> {
    push_arms(writer, frame, &[arm(frame, 0)])
}

fn push_arms(
    writer: &mut DatasetWriter,
    frame: usize,
    arms: &[ArmFrame],
) -> Result<(), DatasetError> {
    let images: Vec<Vec<u8>> = spec()
        .cameras
        .iter()
        .map(|camera| image(frame, camera.image_size_bytes()))
        .collect();
    let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
    writer.push_frame(&FrameRecord {
        arms,
        images: &images,
        depth: &[],
    })
}

/// Three episodes; frames are numbered through.
fn record(dir: &Path) -> DatasetWriter {
    let mut writer = DatasetWriter::create(dir, &spec()).unwrap();
    let mut frame = 0;
    for len in LENGTHS {
        for _ in 0..len {
            push(&mut writer, frame).unwrap();
            frame += 1;
        }
        writer.end_episode().unwrap();
    }
    writer
}

/// The error and its causes, as they are told.
fn error_of(dir: &Path) -> String {
    let error = Dataset::open(dir).unwrap_err();
    let mut told = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        told = format!("{told}: {cause}");
        source = cause.source();
    }
    told
}

#[test]
fn everything_written_is_read_back() {
    let folder = Folder::new("round-trip");
    let totals = record(&folder.0).finish().unwrap();
    assert_eq!(
        totals,
        Totals {
            episodes: 3,
            frames: 138
        }
    );

    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(dataset.spec(), &spec());
    assert_eq!(dataset.fps(), 25);
    assert_eq!(dataset.camera_names(), ["scope", "overview"]);
    assert_eq!(dataset.len(), 138);
    let starts: Vec<(usize, usize, usize)> = dataset
        .episodes()
        .iter()
        .map(|e| (e.index, e.start, e.len))
        .collect();
    assert_eq!(starts, [(0, 0, 5), (1, 5, 130), (2, 135, 3)]);
    for frame in 0..dataset.len() {
        let state = narrow(numbers(frame, 0.5)).map(f32::to_bits);
        assert_eq!(dataset.state(frame, 0).map(f32::to_bits), state);
        assert_eq!(bits(dataset.tip_pose(frame, 0)), bits(numbers(frame, 0.05)));
        let action = narrow(numbers(frame, 0.06)).map(f64::from);
        assert_eq!(bits(dataset.action(frame, 0)), bits(action));
        for (camera, spec) in spec().cameras.iter().enumerate() {
            let rgb = dataset.image_rgb(frame, camera).unwrap();
            assert_eq!(rgb.dimensions(), (spec.width, spec.height));
            assert_eq!(rgb.into_raw(), image(frame, spec.image_size_bytes()));
        }
    }
}

#[test]
fn first_episodes_can_be_opened_alone() {
    let folder = Folder::new("first");
    record(&folder.0).finish().unwrap();
    // The third file is not even looked at.
    fs::remove_file(meta::data_path(&folder.0, 0, 2)).unwrap();
    let dataset = Dataset::open_first(&folder.0, Some(2)).unwrap();
    assert_eq!((dataset.episodes().len(), dataset.len()), (2, 135));
    let message = Dataset::open_first(&folder.0, Some(4))
        .unwrap_err()
        .to_string();
    assert!(
        message.ends_with("the number of episodes is 3, expected 4"),
        "{message}"
    );
}

#[test]
fn some_cameras_can_be_opened_alone() {
    let folder = Folder::new("cameras");
    record(&folder.0).finish().unwrap();
    let all = Dataset::cameras_in(&folder.0).unwrap();
    assert_eq!(all.len(), 2);
    let last = &all[1..];
    let dataset = Dataset::open_part(&folder.0, None, Some(last)).unwrap();
    assert_eq!(dataset.camera_names(), last);
    let size = spec().cameras[1].image_size_bytes();
    let rgb = dataset.image_rgb(7, 0).unwrap();
    assert_eq!(rgb.into_raw(), image(7, size));
    let none = ["nose".to_owned()];
    let refused = Dataset::open_part(&folder.0, None, Some(&none));
    let message = refused.unwrap_err().to_string();
    assert!(
        message.contains("nose") && message.contains(&all[1]),
        "{message}"
    );
}

#[test]
fn writer_dropped_in_an_episode_leaves_the_finished_ones() {
    let folder = Folder::new("dropped");
    let mut writer = record(&folder.0);
    push(&mut writer, 0).unwrap();
    drop(writer);
    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!((dataset.episodes().len(), dataset.len()), (3, 138));
}

#[test]
fn crash_between_data_and_commit_leaves_the_committed_episodes() {
    let folder = Folder::new("crash");
    let info = meta::info_path(&folder.0);
    let mut writer = record(&folder.0);
    let committed = fs::read(&info).unwrap();
    push(&mut writer, 0).unwrap();
    writer.end_episode().unwrap();
    drop(writer);
    // As if the power had failed after the table of episodes, and in the middle of another data
    // file.
    fs::write(&info, committed).unwrap();
    fs::write(
        folder.0.join("data/chunk-000/file-004.parquet.partial"),
        "PAR1",
    )
    .unwrap();
    assert_eq!(Dataset::open(&folder.0).unwrap().episodes().len(), 3);
}

#[test]
fn discarded_episode_leaves_no_trace() {
    let folder = Folder::new("discard");
    let mut writer = DatasetWriter::create(&folder.0, &spec()).unwrap();
    push(&mut writer, 7).unwrap();
    writer.discard_episode();
    push(&mut writer, 1).unwrap();
    writer.end_episode().unwrap();
    writer.finish().unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(dataset.len(), 1);
    assert_eq!(bits(dataset.tip_pose(0, 0)), bits(numbers(1, 0.05)));
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(meta::stats_path(&folder.0)).unwrap()).unwrap();
    assert_eq!(stats[schema::TIP_POSE]["count"], serde_json::json!([1]));
    assert_eq!(
        stats["observation.images.scope"]["count"],
        serde_json::json!([1])
    );
}

#[test]
fn recording_without_an_episode_is_an_empty_dataset() {
    let folder = Folder::new("empty");
    DatasetWriter::create(&folder.0, &spec())
        .unwrap()
        .finish()
        .unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    assert!(dataset.is_empty() && dataset.episodes().is_empty());
    assert_eq!(dataset.spec(), &spec());
}
