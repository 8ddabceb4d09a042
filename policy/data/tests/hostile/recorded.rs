//! A small dataset: two episodes of four frames with depth.

use std::path::Path;

use hal::Intrinsics;
use trocar_data::dataset::{
    ArmFrame, CameraSpec, DatasetSpec, DatasetWriter, DepthFrame, FrameRecord, VideoCodec,
};

const SIDE: u32 = 8;

/// Records it into `dir`, as `camera` sees it.
pub(crate) fn record(dir: &Path, camera: &str) {
    record_with(dir, camera, None);
}

/// The same, with colour as video.
pub(crate) fn record_with(dir: &Path, camera: &str, video: Option<VideoCodec>) {
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "Lift the needle".to_owned(),
        cameras: vec![CameraSpec {
            name: camera.to_owned(),
            width: SIDE,
            height: SIDE,
            depth: Some(Intrinsics::from_vertical_fov(SIDE, SIDE, 1.0)),
        }],
        intervention: false,
    };
    let mut writer = DatasetWriter::create_with(dir, &spec, video).unwrap();
    for episode in 0..2_u8 {
        for frame in 0..4_u8 {
            let value = f32::from(4 * episode + frame);
            let arm = ArmFrame {
                state: [value; 7],
                tip_pose: [f64::from(value); 7],
                action: [f64::from(value); 8],
            };
            let rgb: Vec<u8> = (0..192).map(|at: u8| at.wrapping_mul(frame + 3)).collect();
            let depth = DepthFrame {
                units: &[u16::from(frame + 1) * 900; 64],
                instance: &[frame + 1; 64],
                camera_in_scene: [0.5; 7],
            };
            let frame = FrameRecord {
                arms: &[arm],
                images: &[&rgb],
                depth: &[depth],
            };
            writer.push_frame(&frame).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
}
