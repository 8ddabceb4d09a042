//! A dataset that is written, cut off or damaged, and read again.

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
    // As if the power had failed after the table of episodes, and in the middle of another data file.
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

#[test]
fn writer_refuses_what_does_not_fit() {
    let folder = Folder::new("refuse");
    let mut writer = DatasetWriter::create(&folder.0, &spec()).unwrap();
    let frame = FrameRecord {
        arms: &[STILL],
        images: &[],
        depth: &[],
    };
    let message = writer.push_frame(&frame).unwrap_err().to_string();
    assert_eq!(message, "the frame is 0 images, expected 2, one a camera");
    let message = writer
        .push_frame(&FrameRecord {
            images: &[&[0; 1152], &[0; 287]],
            ..frame
        })
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "the image of overview is 287 bytes, expected 288 for 8 x 12 RGB"
    );
    let mut action = [0.0; 8];
    action[7] = f64::NAN;
    let message = writer
        .push_frame(&FrameRecord {
            arms: &[ArmFrame { action, ..STILL }],
            ..frame
        })
        .unwrap_err()
        .to_string();
    assert_eq!(message, "action[7] is NaN, expected a finite number");
    assert!(writer.end_episode().is_err(), "no frame was added");
    push(&mut writer, 0).unwrap();
    assert!(writer.finish().is_err(), "an episode is open");
    assert!(matches!(
        DatasetWriter::create(&folder.0, &spec()),
        Err(DatasetError::Exists { .. })
    ));
}

#[test]
fn missing_and_cut_files_are_named() {
    let folder = Folder::new("damaged");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 1);
    let whole = fs::read(&data).unwrap();
    for len in [0, 3, whole.len() / 2, whole.len() - 1] {
        fs::write(&data, &whole[..len]).unwrap();
        let message = error_of(&folder.0);
        assert!(
            message.contains("file-001.parquet: not a whole parquet file"),
            "{message}"
        );
    }
    fs::remove_file(&data).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("file-001.parquet: cannot be read or written: No such file"),
        "{message}"
    );
    fs::write(&data, &whole).unwrap();

    for file in [
        "meta/tasks.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
    ] {
        let path = folder.0.join(file);
        let kept = fs::read(&path).unwrap();
        fs::write(&path, &kept[..kept.len() / 2]).unwrap();
        let message = error_of(&folder.0);
        assert!(message.contains(file), "{message}");
        fs::write(&path, kept).unwrap();
    }
    let message = error_of(&folder.0.join("nowhere"));
    assert!(
        message.contains("nowhere/meta/info.json: cannot be read or written: No such file"),
        "{message}"
    );
    assert_eq!(message.matches("No such file").count(), 1, "{message}");
}

#[test]
fn damaged_image_is_an_error_not_a_picture() {
    let folder = Folder::new("image");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 0);
    let mut bytes = fs::read(&data).unwrap();
    let place = bytes
        .windows(8)
        .position(|window| window == b"\x89PNG\r\n\x1a\n")
        .unwrap();
    bytes[place + 1] = b'X';
    fs::write(&data, bytes).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    let message = dataset.image_rgb(0, 0).unwrap_err().to_string();
    assert!(
        message.contains("scope of frame 0") && message.contains("file-000.parquet"),
        "{message}"
    );
    assert!(dataset.image_rgb(1, 0).is_ok());
}

#[test]
fn other_versions_features_and_widths_are_refused() {
    let folder = Folder::new("info");
    record(&folder.0).finish().unwrap();
    let path = meta::info_path(&folder.0);
    let whole = fs::read_to_string(&path).unwrap();
    let check = |from: &str, to: &str, expected: &str| {
        assert!(whole.contains(from), "{from}");
        fs::write(&path, whole.replace(from, to)).unwrap();
        let message = error_of(&folder.0);
        assert!(
            message.contains("info.json") && message.contains(expected),
            "{message}"
        );
    };
    check(
        "\"v3.0\"",
        "\"v1.6\"",
        "codebase_version is \"v1.6\", this program reads v3.0, v2.1, v2.0",
    );
    check(
        "observation.tip_pose",
        "observation.tool",
        "feature observation.tip_pose is missing",
    );
    check(
        "        8\n",
        "        9\n",
        "the shape of action is [9], expected 8",
    );
    check(
        "\"dtype\": \"image\"",
        "\"dtype\": \"jpeg\"",
        "observation.images.scope is jpeg, expected image",
    );
    check("\"fps\": 25,", "", "missing field `fps`");
    check(
        "\"total_episodes\": 3",
        "\"total_episodes\": 9",
        "the number of episodes is 3, expected 9",
    );
}

#[test]
fn a_number_that_is_not_finite_is_refused_with_its_row() {
    let folder = Folder::new("not-finite");
    record(&folder.0).finish().unwrap();
    let data = meta::data_path(&folder.0, 0, 0);
    let whole = fs::read(&data).unwrap();
    let number = arm(2, 0).tip_pose[1].to_le_bytes();
    let places = whole.windows(8).enumerate();
    let places: Vec<usize> = places
        .filter(|(_, window)| *window == number)
        .map(|(at, _)| at)
        .collect();
    assert!(!places.is_empty(), "numbers are stored as they are");
    let mut bytes = whole;
    for at in places {
        bytes[at..at + 8].copy_from_slice(&f64::NEG_INFINITY.to_le_bytes());
    }
    fs::write(&data, bytes).unwrap();
    let message = error_of(&folder.0);
    let reason = "file-000.parquet: observation.tip_pose in row 2 is -inf, expected finite";
    assert!(message.contains(reason), "{message}");
}

#[test]
fn data_that_disagrees_with_the_description_is_refused() {
    let folder = Folder::new("disagree");
    record(&folder.0).finish().unwrap();
    let [first, third] = [0, 2].map(|file| meta::data_path(&folder.0, 0, file));
    let kept = fs::read(&first).unwrap();
    fs::copy(&third, &first).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.contains("file-000.parquet: episode 0 is cut off by the end of the file"),
        "{message}"
    );
    fs::write(&first, kept).unwrap();

    // A data file in which a column has another name, and one in which it has another width.
    let other = Folder::new("disagree-other");
    let mut narrow = spec();
    narrow.cameras.pop();
    let mut writer = DatasetWriter::create(&other.0, &narrow).unwrap();
    let image = image(0, narrow.cameras[0].image_size_bytes());
    let frame = FrameRecord {
        arms: &[STILL],
        images: &[&image],
        depth: &[],
    };
    (0..5).for_each(|_| writer.push_frame(&frame).unwrap());
    writer.end_episode().unwrap();
    fs::copy(meta::data_path(&other.0, 0, 0), &first).unwrap();
    let message = error_of(&folder.0);
    assert!(
        message.ends_with("column observation.images.overview is missing"),
        "{message}"
    );

    let table = super::table::Table::open(&first).unwrap();
    let message = table
        .vectors::<9>(schema::ACTION, 1)
        .unwrap_err()
        .to_string();
    assert!(
        message.ends_with("action is 8 numbers wide, expected 9"),
        "{message}"
    );
}

#[test]
fn two_arms_are_read_back_as_they_were_written() {
    let folder = Folder::new("two-arms");
    let spec = DatasetSpec { arms: 2, ..spec() };
    let mut writer = DatasetWriter::create(&folder.0, &spec).unwrap();
    // More frames than are handed to the file together.
    for frame in 0..70 {
        push_arms(&mut writer, frame, &[arm(frame, 0), arm(frame, 1)]).unwrap();
    }
    writer.end_episode().unwrap();
    let message = push_arms(&mut writer, 0, &[arm(0, 0)])
        .unwrap_err()
        .to_string();
    assert_eq!(message, "the frame is of 1 arms, expected 2");
    let mut nan = arm(0, 1);
    nan.tip_pose[2] = f64::NAN;
    let message = push_arms(&mut writer, 0, &[arm(0, 0), nan])
        .unwrap_err()
        .to_string();
    assert_eq!(message, "psm2 tip_pose[2] is NaN, expected a finite number");
    writer.finish().unwrap();

    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(
        (dataset.spec(), dataset.arms(), dataset.len()),
        (&spec, 2, 70)
    );
    for frame in 0..dataset.len() {
        for index in 0..2 {
            let written = arm(frame, index);
            let state = dataset.state(frame, index).map(f32::to_bits);
            assert_eq!(state, written.state.map(f32::to_bits));
            assert_eq!(bits(dataset.tip_pose(frame, index)), bits(written.tip_pose));
            let action = narrow(written.action).map(f64::from);
            assert_eq!(bits(dataset.action(frame, index)), bits(action));
        }
    }
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(meta::stats_path(&folder.0)).unwrap()).unwrap();
    let least = |place: usize| stats[schema::ACTION]["min"][place].as_f64().unwrap();
    for (place, index) in [(1, 0), (9, 1)] {
        let values = (0..70).map(|frame| f64::from(narrow(arm(frame, index).action)[1]));
        assert!((least(place) - values.fold(f64::INFINITY, f64::min)).abs() < 1e-12);
    }
}

/// One arm's names stand alone and of two each begins with its arm's.
#[test]
fn names_of_two_arms_have_a_prefix() {
    let described = |arms: usize| {
        let folder = Folder::new(&format!("names-{arms}"));
        let spec = DatasetSpec { arms, ..spec() };
        drop(DatasetWriter::create(&folder.0, &spec).unwrap());
        let text = fs::read(meta::info_path(&folder.0)).unwrap();
        let info: serde_json::Value = serde_json::from_slice(&text).unwrap();
        [schema::STATE, schema::TIP_POSE, schema::ACTION].map(|name| {
            let feature = &info["features"][name];
            let names: Vec<String> = serde_json::from_value(feature["names"].clone()).unwrap();
            assert_eq!(feature["shape"], serde_json::json!([names.len()]));
            (
                feature["dtype"].as_str().unwrap().to_owned(),
                names.join(" "),
            )
        })
    };
    let [state, tip_pose, action] = described(1);
    let joints = "yaw pitch insertion roll wrist_pitch wrist_yaw jaw";
    assert_eq!(state, ("float32".to_owned(), joints.to_owned()));
    assert_eq!(
        tip_pose,
        ("float64".to_owned(), "x y z qx qy qz qw".to_owned())
    );
    assert_eq!(
        action,
        ("float32".to_owned(), "x y z qx qy qz qw jaw".to_owned())
    );
    for (alone, both) in [state, tip_pose, action].into_iter().zip(described(2)) {
        let prefixed = |arm: &str| {
            let names = alone.1.split(' ').map(|name| format!("{arm}_{name}"));
            names.collect::<Vec<_>>().join(" ")
        };
        let names = format!("{} {}", prefixed("psm1"), prefixed("psm2"));
        assert_eq!(both, (alone.0.clone(), names));
    }
}

/// A number of arms that no robot has and vectors that disagree are refused.
#[test]
fn odd_arm_counts_and_vector_lengths_are_refused() {
    for arms in [0, 3] {
        let folder = Folder::new(&format!("arms-{arms}"));
        let spec = DatasetSpec { arms, ..spec() };
        let message = DatasetWriter::create(&folder.0, &spec)
            .unwrap_err()
            .to_string();
        assert_eq!(
            message,
            format!("the number of arms is {arms}, expected 1 to 2")
        );
    }
    let folder = Folder::new("arms-disagree");
    let spec = DatasetSpec { arms: 2, ..spec() };
    drop(DatasetWriter::create(&folder.0, &spec).unwrap());
    let path = meta::info_path(&folder.0);
    let whole = fs::read_to_string(&path).unwrap();
    for (from, to, expected) in [
        (
            "        16\n",
            "        8\n",
            "the shape of action is [8], expected 16",
        ),
        (
            "        14\n",
            "        15\n",
            "the shape of observation.state is [15], expected 7 or 14",
        ),
    ] {
        assert!(whole.contains(from), "{whole}");
        fs::write(&path, whole.replacen(from, to, 1)).unwrap();
        let message = error_of(&folder.0);
        assert!(message.ends_with(expected), "{message}");
    }
}
