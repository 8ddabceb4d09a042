//! Recordings that are resumed are what they would be without the break, and nothing else is
//! resumed.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use hal::{Distortion, Intrinsics};
use serde_json::{Value, json};

use super::{
    ArmFrame, CameraSpec, Dataset, DatasetError, DatasetSpec, DatasetWriter, DepthFrame,
    FrameRecord, Notes, Totals, VideoCodec, meta,
};

/// A folder of its own for one test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let name = format!("trocar-resume-{test}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _absent = fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _absent = fs::remove_dir_all(&self.0);
    }
}

const LENS: Intrinsics = Intrinsics {
    width: 16,
    height: 12,
    fx: 7.1,
    fy: 1.0 / 3.0,
    cx: 2.9,
    cy: 2.0,
    distortion: Distortion::NONE,
};

/// Frames of the episodes: less, more and just as many as between two images that count for the
/// statistics.
const LENGTHS: [usize; 4] = [5, 23, 1, 11];

fn camera(name: &str, depth: Option<Intrinsics>) -> CameraSpec {
    CameraSpec {
        name: name.to_owned(),
        width: LENS.width,
        height: LENS.height,
        depth,
    }
}

fn spec(arms: usize, cameras: Vec<CameraSpec>) -> DatasetSpec {
    DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms,
        task: "Lift the \"needle\"".to_owned(),
        cameras,
        intervention: false,
    }
}

fn coloured() -> DatasetSpec {
    spec(1, vec![camera("scope", None), camera("side", None)])
}

/// Numbers without a short binary form, zeros of both signs among them.
fn numbers<const N: usize>(frame: usize, salt: f64) -> [f64; N] {
    let real = |value: usize| f64::from(u32::try_from(value).unwrap());
    std::array::from_fn(|place| match (frame + place) % 7 {
        0 => -0.0,
        1 => 0.0,
        _ => (real(frame) + salt).sin() / 3.0 + real(place),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the dataset's columns are f32"
)]
fn arm(frame: usize, arm: usize) -> ArmFrame {
    let salt = if arm == 0 { 0.3 } else { 0.7 };
    ArmFrame {
        state: numbers(frame, salt).map(|value| value as f32),
        tip_pose: numbers(frame, 2.0 * salt),
        action: numbers(frame, 3.0 * salt),
    }
}

/// Pixels that are smooth enough for video.
fn image(frame: usize, camera: usize, count: usize) -> Vec<u8> {
    (0..count)
        .map(|place| u8::try_from((frame * 3 + camera * 40 + place / 8) % 256).unwrap())
        .collect()
}

fn push(writer: &mut DatasetWriter, spec: &DatasetSpec, frame: usize) {
    let arms: Vec<ArmFrame> = (0..spec.arms).map(|index| arm(frame, index)).collect();
    let cameras = spec.cameras.iter().enumerate();
    let images: Vec<Vec<u8>> = cameras
        .map(|(index, camera)| image(frame, index, camera.image_size_bytes()))
        .collect();
    let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
    let pixels = image(frame, 3, (LENS.width * LENS.height) as usize);
    let units: Vec<u16> = pixels.iter().map(|&pixel| 37 * u16::from(pixel)).collect();
    let depth: Vec<DepthFrame<'_>> = spec
        .depth_cameras()
        .map(|_| DepthFrame {
            units: &units,
            instance: &pixels,
            camera_in_scene: numbers(frame, 0.9),
        })
        .collect();
    let record = FrameRecord {
        arms: &arms,
        images: &images,
        depth: &depth,
    };
    writer.push_frame(&record).unwrap();
}

/// The episodes `range`, each with a note; frames are numbered through all episodes.
fn add(writer: &mut DatasetWriter, spec: &DatasetSpec, range: std::ops::Range<usize>) {
    for index in range {
        let first: usize = LENGTHS[..index].iter().sum();
        for frame in first..first + LENGTHS[index] {
            push(writer, spec, frame);
        }
        let note = json!({"seed": 3 * index, "light": 1.0 / 3.0});
        writer.end_episode_with(note).unwrap();
    }
}

fn begin(dir: &Path, spec: &DatasetSpec, video: Option<VideoCodec>) -> DatasetWriter {
    let mut writer = DatasetWriter::create_with(dir, spec, video).unwrap();
    writer.describe(json!({"disturb": 0.1})).unwrap();
    writer.keep_options(json!({"seed": 0})).unwrap();
    writer
}

/// Every file below `dir` by its name.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
}

fn relative(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = files(dir).into_iter();
    files
        .map(|(path, bytes)| (path.strip_prefix(dir).unwrap().to_owned(), bytes))
        .collect()
}

/// The two folders have the same files with the same bytes.
fn check_same(resumed: &Path, whole: &Path) {
    let (resumed, whole) = (relative(resumed), relative(whole));
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&resumed), names(&whole));
    for (name, bytes) in &whole {
        assert!(resumed[name] == *bytes, "{} differs", name.display());
    }
}

/// What a recording to `spec` is with and without a break after each number of episodes.
fn check_breaks(test: &str, spec: &DatasetSpec) {
    let whole = Folder::new(&format!("{test}-whole"));
    let mut writer = begin(&whole.0, spec, None);
    add(&mut writer, spec, 0..LENGTHS.len());
    writer.finish().unwrap();
    for done in 0..=LENGTHS.len() {
        let folder = Folder::new(&format!("{test}-{done}"));
        let mut writer = begin(&folder.0, spec, None);
        add(&mut writer, spec, 0..done);
        push(&mut writer, spec, 99);
        drop(writer);
        let mut writer = DatasetWriter::resume(&folder.0, spec, None).unwrap();
        let frames = LENGTHS[..done].iter().sum();
        let episodes = done;
        assert_eq!(writer.totals(), Totals { episodes, frames });
        add(&mut writer, spec, done..LENGTHS.len());
        writer.finish().unwrap();
        check_same(&folder.0, &whole.0);
    }
}

#[test]
fn a_break_leaves_no_trace_in_numbers() {
    check_breaks("numbers", &spec(1, Vec::new()));
}

#[test]
fn a_break_leaves_no_trace_in_pictures() {
    check_breaks("pictures", &coloured());
}

#[test]
fn a_break_leaves_no_trace_in_depth_of_two_arms() {
    let cameras = vec![
        camera("plain", None),
        camera("scope", Some(LENS)),
        camera("side", Some(LENS)),
    ];
    check_breaks("depth", &spec(2, cameras));
}

#[test]
fn what_a_cut_episode_left_is_dropped() {
    let (spec, whole, cut) = (coloured(), Folder::new("left-whole"), Folder::new("left"));
    let mut writer = begin(&whole.0, &spec, None);
    add(&mut writer, &spec, 0..1);
    drop(writer);
    let mut writer = begin(&cut.0, &spec, None);
    add(&mut writer, &spec, 0..1);
    let info = fs::read(meta::info_path(&cut.0)).unwrap();
    add(&mut writer, &spec, 1..3);
    drop(writer);
    // As if the power had failed before the second episode was counted, and in the middle of other
    // files.
    fs::write(meta::info_path(&cut.0), info).unwrap();
    for name in [
        "data/chunk-000/file-007.parquet.partial",
        "meta/stats.json.partial",
        "meta/episodes/chunk-000/file-000.parquet.partial",
    ] {
        fs::write(cut.0.join(name), "PAR1").unwrap();
    }
    assert!(meta::data_path(&cut.0, 0, 2).exists());
    let mut writer = DatasetWriter::resume(&cut.0, &spec, None).unwrap();
    assert_eq!(Notes::read(&cut.0).unwrap().episodes.len(), 1);
    check_same(&cut.0, &whole.0);
    // What is nobody's business here stays.
    fs::write(cut.0.join("data/README"), "mine").unwrap();
    add(&mut writer, &spec, 1..4);
    drop(writer);
    drop(DatasetWriter::resume(&cut.0, &spec, None).unwrap());
    assert_eq!(Dataset::open(&cut.0).unwrap().len(), 40);
    assert_eq!(fs::read(cut.0.join("data/README")).unwrap(), b"mine");
}

/// Other specifications, and how they are told.
fn others() -> Vec<(DatasetSpec, &'static str)> {
    let with_lens = |lens| vec![camera("scope", lens), camera("side", None)];
    let wide = |width| CameraSpec {
        width,
        ..camera("scope", None)
    };
    vec![
        (
            DatasetSpec {
                fps: 30,
                ..coloured()
            },
            "fps 25, now 30 is",
        ),
        (
            DatasetSpec {
                robot_type: "arm".to_owned(),
                ..coloured()
            },
            "robot_type \"psm\", now \"arm\" is",
        ),
        (
            DatasetSpec {
                arms: 2,
                ..coloured()
            },
            "arms: 1, now 2 is",
        ),
        (
            DatasetSpec {
                task: "Pull".to_owned(),
                ..coloured()
            },
            "task \"Lift the \\\"needle\\\"\", now \"Pull\" is",
        ),
        (
            DatasetSpec {
                cameras: vec![camera("side", None)],
                ..coloured()
            },
            "cameras scope, side, now side is",
        ),
        (
            DatasetSpec {
                cameras: vec![wide(18), camera("side", None)],
                ..coloured()
            },
            "camera scope of 16 x 12, now 18 x 12 is",
        ),
        (
            DatasetSpec {
                cameras: with_lens(Some(LENS)),
                ..coloured()
            },
            "camera scope's depth left out, now through fx 7.1,",
        ),
    ]
}

#[test]
fn another_specification_is_refused_by_name() {
    let (folder, spec) = (Folder::new("differs"), coloured());
    let mut writer = begin(&folder.0, &spec, None);
    add(&mut writer, &spec, 0..1);
    drop(writer);
    let before = files(&folder.0);
    for (other, expected) in others() {
        let refused = DatasetWriter::resume(&folder.0, &other, None).unwrap_err();
        assert!(matches!(refused, DatasetError::Differs { .. }));
        let message = refused.to_string();
        assert!(
            message.contains(&format!("was recorded with {expected}")),
            "{message}"
        );
    }
    let filmed = DatasetWriter::resume(&folder.0, &spec, Some(VideoCodec::H264));
    let message = filmed.unwrap_err().to_string();
    let expected = "camera scope's colour as PNG, now h264 is asked for";
    assert!(message.ends_with(expected), "{message}");
    assert!(files(&folder.0) == before, "nothing is changed");
}

#[test]
fn another_lens_is_refused_to_the_bit() {
    let folder = Folder::new("lens");
    let with_lens = |lens| spec(1, vec![camera("scope", Some(lens))]);
    drop(begin(&folder.0, &with_lens(LENS), None));
    drop(DatasetWriter::resume(&folder.0, &with_lens(LENS), None).unwrap());
    let fx = LENS.fx.next_up();
    let refused = DatasetWriter::resume(&folder.0, &with_lens(Intrinsics { fx, ..LENS }), None);
    let message = refused.unwrap_err().to_string();
    assert!(
        message.contains("fx 7.1,") && message.contains(&format!("fx {fx},")),
        "{message}"
    );
    let distortion = Distortion::new([0.0, 0.0, 1e-9, 0.0]);
    let bent = with_lens(Intrinsics { distortion, ..LENS });
    let refused = DatasetWriter::resume(&folder.0, &bent, None);
    let message = refused.unwrap_err().to_string();
    assert!(
        message.contains("distortion [0.0, 0.0, 1e-9, 0.0]"),
        "{message}"
    );
}

#[test]
fn what_is_no_recording_of_this_writer_is_refused() {
    let (folder, spec) = (Folder::new("none"), coloured());
    let refused = |dir: &Path| {
        let error = DatasetWriter::resume(dir, &coloured(), None).unwrap_err();
        error.to_string()
    };
    let message = refused(&folder.0);
    assert!(message.contains("is no dataset"), "{message}");
    assert!(!folder.0.exists());
    let mut writer = begin(&folder.0, &spec, None);
    add(&mut writer, &spec, 0..2);
    // While the first one is at it.
    let message = refused(&folder.0);
    assert!(
        message.ends_with("another recording is writing there"),
        "{message}"
    );
    drop(writer);
    let info = fs::read_to_string(meta::info_path(&folder.0)).unwrap();
    let with = |from: &str, to: &str| {
        assert!(info.contains(from), "{from}");
        fs::write(meta::info_path(&folder.0), info.replace(from, to)).unwrap();
        refused(&folder.0)
    };
    let message = with("\"v3.0\"", "\"v2.1\"");
    assert!(
        message.ends_with("codebase_version v2.1, now v3.0 is asked for"),
        "{message}"
    );
    let message = with("\"total_frames\": 28", "\"total_frames\": 29");
    assert!(
        message.ends_with("total_frames is 29, expected 28"),
        "{message}"
    );
    let message = with("\"wrist_yaw\"", "\"elbow\"");
    assert!(message.contains("was recorded with features "), "{message}");
    fs::write(meta::info_path(&folder.0), &info).unwrap();
    // Several episodes in one file, as LeRobot writes them.
    let row = |index, start, len| meta::EpisodeRow {
        index,
        start,
        len,
        chunk: 0,
        file: 0,
    };
    let rows = [row(0, 0, 5), row(1, 5, 23)];
    meta::write_episodes(&folder.0, &spec.task, spec.fps, &[], &rows).unwrap();
    let message = refused(&folder.0);
    assert!(message.contains("episode 1 is in "), "{message}");
}

/// Mean and standard deviation of a camera's first channel.
fn moments(dir: &Path) -> [f64; 2] {
    let text = fs::read(meta::stats_path(dir)).unwrap();
    let stats: Value = serde_json::from_slice(&text).unwrap();
    let of = |name: &str| stats["observation.images.side"][name][0][0][0].as_f64();
    ["mean", "std"].map(|name| of(name).unwrap())
}

#[test]
fn a_break_leaves_video_as_it_was_and_statistics_close() {
    let (spec, whole, cut) = (coloured(), Folder::new("video-whole"), Folder::new("video"));
    let codec = Some(VideoCodec::H264);
    let mut writer = begin(&whole.0, &spec, codec);
    add(&mut writer, &spec, 0..4);
    writer.finish().unwrap();
    let mut writer = begin(&cut.0, &spec, codec);
    add(&mut writer, &spec, 0..2);
    push(&mut writer, &spec, 99);
    drop(writer);
    // What a kill leaves of a video.
    let film = meta::video_path(&cut.0, "observation.images.side", 0, 2);
    fs::write(film.with_extension("mp4.partial"), "mp4").unwrap();
    let other = DatasetWriter::resume(&cut.0, &spec, Some(VideoCodec::Av1));
    let message = other.unwrap_err().to_string();
    assert!(
        message.ends_with("colour as h264, now av1 is asked for"),
        "{message}"
    );
    let mut writer = DatasetWriter::resume(&cut.0, &spec, codec).unwrap();
    add(&mut writer, &spec, 2..4);
    writer.finish().unwrap();
    for (one, other) in moments(&cut.0).into_iter().zip(moments(&whole.0)) {
        assert!((one - other).abs() < 0.01, "{one} {other}");
    }
    // All else is the same to the bit.
    fs::copy(meta::stats_path(&whole.0), meta::stats_path(&cut.0)).unwrap();
    check_same(&cut.0, &whole.0);
}
