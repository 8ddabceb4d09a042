//! Depth and instance ids come back bit for bit, beside cameras that keep none.

use std::fs;
use std::path::PathBuf;

use hal::{Distortion, Intrinsics};

use super::{
    ArmFrame, CameraSpec, Dataset, DatasetError, DatasetSpec, DatasetWriter, DepthFrame,
    FrameRecord, meta,
};

const STILL: ArmFrame = ArmFrame {
    state: [0.0; 7],
    tip_pose: [0.0; 7],
    action: [0.0; 8],
};

const LENS: Intrinsics = Intrinsics {
    width: 6,
    height: 4,
    fx: 7.1,
    fy: 1.0 / 3.0,
    cx: 2.9,
    cy: 2.0,
    distortion: Distortion::new([-0.3, 0.1, 0.001, -1e-9]),
};

fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("trocar-depth-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&path);
    path
}

fn spec() -> DatasetSpec {
    let camera = |name: &str, depth| CameraSpec {
        name: name.to_owned(),
        width: LENS.width,
        height: LENS.height,
        depth,
    };
    DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "look".to_owned(),
        cameras: vec![camera("plain", None), camera("scope", Some(LENS))],
        intervention: false,
    }
}

fn units(frame: u16) -> Vec<u16> {
    (0..24_u16)
        .map(|place| place.wrapping_mul(2731).wrapping_add(frame * 4099))
        .collect()
}

fn ids(frame: u8) -> Vec<u8> {
    (0..24_u8).map(|place| place * 10 + frame).collect()
}

fn pose(frame: u16) -> [f64; 7] {
    [f64::from(frame) / 3.0, -0.1, 0.2, 0.0, 0.6, 0.0, 0.8]
}

fn push(writer: &mut DatasetWriter, depth: &[DepthFrame<'_>]) -> Result<(), DatasetError> {
    writer.push_frame(&FrameRecord {
        arms: &[STILL],
        images: &[&[9; 72], &[8; 72]],
        depth,
    })
}

fn record(name: &str) -> PathBuf {
    let folder = folder(name);
    let mut writer = DatasetWriter::create(&folder, &spec()).unwrap();
    for episode in 0..2_u8 {
        for step in 0..3_u8 {
            let frame = 3 * episode + step;
            let (units, instance) = (units(frame.into()), ids(frame));
            let depth = DepthFrame {
                units: &units,
                instance: &instance,
                camera_in_scene: pose(frame.into()),
            };
            push(&mut writer, &[depth]).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
    folder
}

#[test]
fn depth_ids_pose_and_lens_come_back_bit_for_bit() {
    let folder = record("back");
    let dataset = Dataset::open(&folder).unwrap();
    assert_eq!(dataset.spec(), &spec());
    for frame in 0..6_u8 {
        let found = dataset.depth(frame.into(), 1).unwrap();
        assert_eq!(found.units, units(frame.into()), "{frame}");
        assert_eq!(found.instance, ids(frame), "{frame}");
        let bits = |pose: [f64; 7]| pose.map(f64::to_bits);
        assert_eq!(bits(found.camera_in_scene), bits(pose(frame.into())));
        assert_eq!(found.intrinsics, LENS);
    }
    let error = dataset.depth(0, 0).unwrap_err().to_string();
    assert!(
        error.ends_with("observation.depth.plain is missing"),
        "{error}"
    );
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn frames_without_their_depth_or_of_another_size_are_refused() {
    let folder = folder("refused");
    let mut writer = DatasetWriter::create(&folder, &spec()).unwrap();
    let message = push(&mut writer, &[]).unwrap_err().to_string();
    assert_eq!(
        message,
        "the frame is with depth of 0 cameras, expected of 1"
    );
    let short = DepthFrame {
        units: &units(0),
        instance: &[1; 23],
        camera_in_scene: pose(0),
    };
    let message = push(&mut writer, &[short]).unwrap_err().to_string();
    assert_eq!(
        message,
        "the instance ids of scope is 23 pixels, expected 24"
    );
    assert_eq!(writer.pending_frames(), 0);
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn another_unit_or_lens_is_refused_by_name() {
    let folder = record("unit");
    let path = meta::info_path(&folder);
    let text = fs::read_to_string(&path).unwrap();
    for (from, to, what) in [
        (
            "0.00002",
            "0.001",
            "depth_unit_m of observation.depth.scope",
        ),
        ("7.1", "-7.1", "fx of observation.depth.scope"),
    ] {
        let changed = text.replace(from, to);
        assert_ne!(changed, text, "{from}");
        fs::write(&path, changed).unwrap();
        let error = Dataset::open(&folder).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
    fs::remove_dir_all(&folder).unwrap();
}
