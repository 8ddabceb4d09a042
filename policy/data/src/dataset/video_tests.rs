//! Cameras kept as video, and datasets of v2.1. These need ffmpeg, as the code does.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::{Value, json};

use super::{
    ArmFrame, CameraSpec, Dataset, DatasetError, DatasetSpec, DatasetWriter, FrameRecord,
    VideoCodec, meta,
};

struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("trocar-video-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const SIDE: u32 = 64;
const LENGTHS: [usize; 2] = [9, 70];

fn spec() -> DatasetSpec {
    let camera = |name: &str| CameraSpec {
        name: name.to_owned(),
        width: SIDE,
        height: SIDE,
        depth: None,
    };
    DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "Lift the needle".to_owned(),
        cameras: vec![camera("scope"), camera("side")],
        intervention: false,
    }
}

/// Eight bars, black or white, that spell the frame's number: any two frames differ in at least one
/// bar.
fn image(frame: usize, camera: usize) -> Vec<u8> {
    let number = 2 * frame + camera;
    let bar = |x: usize| if number >> (x / 8) & 1 == 1 { 230 } else { 20 };
    let side = SIDE as usize;
    (0..side * side)
        .flat_map(|at| [bar(at % side); 3])
        .collect()
}

/// The number that an image spells.
fn spelled(rgb: &[u8]) -> usize {
    let row = 3 * SIDE as usize * 32;
    (0..8)
        .map(|bar| usize::from(rgb[row + 3 * (8 * bar + 4)] > 128) << bar)
        .sum()
}

fn push(writer: &mut DatasetWriter, frame: usize) -> Result<(), DatasetError> {
    let arm = ArmFrame {
        state: [0.5; 7],
        tip_pose: [0.25; 7],
        action: [0.125; 8],
    };
    let images = [image(frame, 0), image(frame, 1)];
    writer.push_frame(&FrameRecord {
        arms: &[arm],
        images: &[&images[0], &images[1]],
        depth: &[],
    })
}

fn record(dir: &Path, codec: Option<VideoCodec>) -> DatasetWriter {
    let mut writer = DatasetWriter::create_with(dir, &spec(), codec).unwrap();
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

fn check_frames(dataset: &Dataset, frames: impl Iterator<Item = usize>) {
    for frame in frames {
        for camera in 0..2 {
            let rgb = dataset.image_rgb(frame, camera).unwrap();
            assert_eq!(rgb.dimensions(), (SIDE, SIDE));
            let found = spelled(rgb.as_raw());
            assert_eq!(
                found,
                2 * frame + camera,
                "frame {frame} of camera {camera}"
            );
            let pairs = rgb.as_raw().iter().zip(image(frame, camera));
            let worst = pairs.map(|(a, b)| a.abs_diff(b)).max().unwrap();
            assert!(worst < 60, "{worst} in frame {frame}");
        }
    }
}

#[test]
fn every_frame_of_a_video_is_the_one_that_was_recorded() {
    for codec in [VideoCodec::H264, VideoCodec::Av1] {
        let folder = Folder::new(codec.name());
        record(&folder.0, Some(codec)).finish().unwrap();
        let info: Value =
            serde_json::from_slice(&fs::read(meta::info_path(&folder.0)).unwrap()).unwrap();
        let feature = &info["features"]["observation.images.side"];
        assert_eq!(feature["dtype"], "video");
        assert_eq!(feature["info"]["video.codec"], codec.name());
        let dataset = Dataset::open(&folder.0).unwrap();
        assert_eq!(dataset.spec(), &spec());
        let total: usize = LENGTHS.iter().sum();
        check_frames(&dataset, 0..total);
        // Against the order of the file, and over the bounds of pieces.
        check_frames(&dataset, [78, 9, 73, 8, 72, 0].into_iter());
    }
}

/// Of datasets that are read as one, some may keep a camera as video and others not.
#[test]
fn video_and_png_are_read_as_one_dataset() {
    let folder = Folder::new("joined");
    let (png, video) = (folder.0.join("png"), folder.0.join("video"));
    fs::create_dir_all(&folder.0).unwrap();
    record(&png, None).finish().unwrap();
    record(&video, Some(VideoCodec::H264)).finish().unwrap();
    let total: usize = LENGTHS.iter().sum();
    let dirs = [video.clone(), png, video];
    let joined = Dataset::open_joined(&dirs, None, None, false).unwrap();
    assert_eq!((joined.len(), joined.episodes().len()), (3 * total, 6));
    for part in 0..3 {
        for frame in [0, 8, 9, 73, 78] {
            for camera in 0..2 {
                let rgb = joined.image_rgb(part * total + frame, camera).unwrap();
                assert_eq!(spelled(rgb.as_raw()), 2 * frame + camera);
            }
        }
    }
}

#[test]
fn an_episode_that_is_given_up_leaves_no_video() {
    let folder = Folder::new("given-up");
    let mut writer = record(&folder.0, Some(VideoCodec::H264));
    push(&mut writer, 5).unwrap();
    writer.discard_episode();
    push(&mut writer, 6).unwrap();
    drop(writer);
    let videos = folder.0.join("videos/observation.images.scope/chunk-000");
    let mut names: Vec<_> = fs::read_dir(videos)
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();
    assert_eq!(names, ["file-000.mp4", "file-001.mp4"]);
    assert_eq!(Dataset::open(&folder.0).unwrap().episodes().len(), 2);
}

fn refusal(dir: &Path) -> String {
    match Dataset::open(dir) {
        Err(error) => error.to_string(),
        Ok(dataset) => dataset.image_rgb(9, 0).unwrap_err().to_string(),
    }
}

#[test]
fn missing_cut_and_foreign_videos_are_refused_by_name() {
    let folder = Folder::new("damaged");
    record(&folder.0, Some(VideoCodec::H264)).finish().unwrap();
    let path = meta::video_path(&folder.0, "observation.images.scope", 0, 1);
    let other = meta::video_path(&folder.0, "observation.images.scope", 0, 0);
    let good = fs::read(&path).unwrap();

    fs::remove_file(&path).unwrap();
    let message = refusal(&folder.0);
    assert!(message.contains("file-001.mp4"), "{message}");
    assert!(message.contains("No such file"), "{message}");

    fs::write(&path, &good[..good.len() / 2]).unwrap();
    assert!(refusal(&folder.0).contains("file-001.mp4"));
    fs::write(&path, b"no video").unwrap();
    assert!(refusal(&folder.0).contains("file-001.mp4"));
    // Whole, but of another episode.
    fs::copy(&other, &path).unwrap();
    let message = refusal(&folder.0);
    assert!(
        message.contains("no frame is shown at 2.760000 s"),
        "{message}"
    );
    assert!(message.contains("it has 9"), "{message}");
    // The first fifth of the file's pictures are zeros.
    let mut holes = good.clone();
    let end = holes.len();
    holes[48..end / 5].fill(0);
    fs::write(&path, &holes).unwrap();
    assert!(refusal(&folder.0).contains("file-001.mp4"));
    // A size that is not the description's.
    fs::write(&path, &good).unwrap();
    let info = meta::info_path(&folder.0);
    let text = fs::read_to_string(&info).unwrap();
    fs::write(&info, text.replacen("64,", "128,", 1)).unwrap();
    let message = refusal(&folder.0);
    assert!(message.contains("bytes, expected"), "{message}");
}

#[test]
fn a_camera_with_odd_sides_cannot_be_filmed() {
    let folder = Folder::new("odd");
    let mut odd = spec();
    odd.cameras[1].height = 63;
    let error = DatasetWriter::create_with(&folder.0, &odd, Some(VideoCodec::H264)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "camera \"side\" is 64 x 63, expected even sides, for video"
    );
}

/// Puts a dataset of v3.0 with a file an episode into the form of v2.1.
fn to_v21(dir: &Path) {
    let path = meta::info_path(dir);
    let mut info: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let object = info.as_object_mut().unwrap();
    for key in ["data_files_size_in_mb", "video_files_size_in_mb"] {
        object.remove(key);
    }
    object.insert("codebase_version".to_owned(), json!("v2.1"));
    object.insert("total_chunks".to_owned(), json!(1));
    object.insert("total_videos".to_owned(), json!(4));
    for name in ["scope", "side"] {
        let feature = &mut info["features"][format!("observation.images.{name}")];
        feature["shape"] = json!([3, SIDE, SIDE]);
        feature["names"] = json!(["channels", "height", "width"]);
    }
    fs::write(&path, info.to_string()).unwrap();
    let mut episodes = String::new();
    for (index, length) in LENGTHS.iter().enumerate() {
        let line = json!({"episode_index": index, "tasks": ["Lift the needle"], "length": length});
        episodes += &format!("{line}\n");
        let rows = dir.join(format!("data/chunk-000/episode_{index:06}.parquet"));
        fs::rename(meta::data_path(dir, 0, index), rows).unwrap();
        for name in ["scope", "side"] {
            let feature = format!("observation.images.{name}");
            let from = meta::video_path(dir, &feature, 0, index);
            let to = dir.join(format!("videos/chunk-000/{feature}/episode_{index:06}.mp4"));
            if from.exists() {
                fs::create_dir_all(to.parent().unwrap()).unwrap();
                fs::rename(from, to).unwrap();
            }
        }
    }
    fs::write(dir.join("meta/episodes.jsonl"), episodes).unwrap();
    let task = json!({"task_index": 0, "task": "Lift the needle"});
    fs::write(dir.join("meta/tasks.jsonl"), format!("{task}\n")).unwrap();
    fs::remove_dir_all(dir.join("meta/episodes")).unwrap();
    fs::remove_file(meta::tasks_path(dir)).unwrap();
}

#[test]
fn datasets_of_version_2_1_are_read_with_images_and_with_video() {
    for codec in [None, Some(VideoCodec::H264)] {
        let folder = Folder::new(&format!("v21-{codec:?}"));
        record(&folder.0, codec).finish().unwrap();
        to_v21(&folder.0);
        let dataset = Dataset::open(&folder.0).unwrap();
        assert_eq!(dataset.spec(), &spec());
        assert_eq!(dataset.len(), 79);
        check_frames(&dataset, [0, 8, 9, 40, 78].into_iter());
        assert_eq!(
            dataset.action(78, 0).map(f64::to_bits),
            [0.125_f64.to_bits(); 8]
        );
        let first = Dataset::open_first(&folder.0, Some(1)).unwrap();
        assert_eq!(first.len(), 9);

        let lines = folder.0.join("meta/episodes.jsonl");
        let text = fs::read_to_string(&lines).unwrap();
        for (from, to, reason) in [
            ("\"length\":70", "\"length\":71", "cut off"),
            ("\"length\":70", "\"length\":-1", "malformed"),
            (
                "\"episode_index\":1",
                "\"episode_index\":7",
                "episode_index is 7, expected 1",
            ),
        ] {
            fs::write(&lines, text.replace(from, to)).unwrap();
            let message = Dataset::open(&folder.0).unwrap_err().to_string();
            let of_video = codec.is_some() && reason == "cut off";
            let reason = if of_video {
                "no frame is shown"
            } else {
                reason
            };
            assert!(message.contains(reason), "{message}");
        }
    }
}
