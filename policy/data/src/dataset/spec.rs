//! What a dataset is of, read from its description and checked.
//!
//! The number of arms is not stated in the format; it follows from the widths of
//! `observation.state` (7 an arm), `observation.tip_pose` (7) and `action` (8).

use std::path::Path;

use hal::ARM_NAMES;

use super::{
    ACTION_WIDTH, CameraSpec, DatasetError, DatasetSpec, STATE_WIDTH, TIP_POSE_WIDTH, depth,
    error::mismatch,
    layout, meta,
    png::SIDE_MAX,
    schema::{ACTION, Feature, IMAGE_PREFIX, INTERVENTION, Info, STATE, TIP_POSE},
};

/// The features of cameras that are kept as video.
pub(super) fn video_features(info: &Info) -> Vec<String> {
    let features = info.features.iter();
    features
        .filter(|(name, feature)| name.starts_with(IMAGE_PREFIX) && feature.dtype == VIDEO)
        .map(|(name, _)| name.clone())
        .collect()
}

/// What `info.json` calls a feature that is kept as video.
const VIDEO: &str = "video";

/// The specification that `info`, out of the folder `dir`, amounts to. Cameras come in the order of
/// `features`.
pub(super) fn read_spec(dir: &Path, info: &Info) -> Result<DatasetSpec, DatasetError> {
    let path = meta::info_path(dir);
    let arms = read_arms(&path, info)?;
    if info.fps == 0 {
        return Err(mismatch(path, "fps", 0, "at least 1"));
    }
    let mut cameras = Vec::new();
    for (name, feature) in &info.features {
        if let Some(camera) = name.strip_prefix(IMAGE_PREFIX) {
            let mut camera = camera_spec(&path, camera, feature)?;
            camera.depth = depth::read_lens(&path, info, &camera)?;
            cameras.push(camera);
        }
    }
    Ok(DatasetSpec {
        fps: info.fps,
        robot_type: info.robot_type.clone().unwrap_or_default(),
        arms,
        task: layout::read_task(dir, info)?,
        cameras,
        intervention: info.features.iter().any(is_intervention),
    })
}

/// Whether a feature is LeRobot's that says who drove.
fn is_intervention((name, feature): &(String, Feature)) -> bool {
    name == INTERVENTION && feature.dtype == "bool" && feature.shape == [1]
}

/// How many arms the vectors are of: as many as the state has room for, and the others must agree.
fn read_arms(path: &Path, info: &Info) -> Result<usize, DatasetError> {
    let mut arms = 1..=ARM_NAMES.len();
    for (name, width) in [
        (STATE, STATE_WIDTH),
        (TIP_POSE, TIP_POSE_WIDTH),
        (ACTION, ACTION_WIDTH),
    ] {
        let feature = info.features.iter().find(|(other, _)| other == name);
        let Some((_, feature)) = feature else {
            return Err(DatasetError::Missing {
                path: path.to_owned(),
                name: format!("feature {name}"),
            });
        };
        let Some(found) = arms.clone().find(|arms| feature.shape == [arms * width]) else {
            let expected: Vec<String> = arms.map(|arms| (arms * width).to_string()).collect();
            let what = format!("the shape of {name}");
            let found = format!("{:?}", feature.shape);
            return Err(mismatch(
                path.to_owned(),
                &what,
                found,
                expected.join(" or "),
            ));
        };
        arms = found..=found;
    }
    Ok(*arms.start())
}

/// A camera's size from its feature's shape, `[height, width, 3]`, or `[3, height, width]` where
/// the names say that channels come first, as in older datasets. Depth is filled in by the caller.
pub(super) fn camera_spec(
    path: &Path,
    name: &str,
    feature: &Feature,
) -> Result<CameraSpec, DatasetError> {
    if feature.dtype != "image" && feature.dtype != VIDEO {
        let what = format!("the type of {IMAGE_PREFIX}{name}");
        return Err(mismatch(
            path.to_owned(),
            &what,
            &feature.dtype,
            "image: PNG in the data files, or video",
        ));
    }
    // The name becomes a folder's, which must not lead elsewhere.
    if name.is_empty() || name.contains(['/', '\\']) {
        let what = "a camera's name";
        return Err(mismatch(path.to_owned(), what, name, "a name without '/'"));
    }
    let pixels = |value: usize| {
        let value = u32::try_from(value).ok();
        value.filter(|value| (1..=SIDE_MAX).contains(value))
    };
    let channels_first = feature.names[0] == "channels" || feature.names[0] == "channel";
    let shape = match feature.shape[..] {
        [3, height, width] if channels_first => vec![height, width, 3],
        _ => feature.shape.clone(),
    };
    if let [height, width, 3] = shape[..]
        && let (Some(height), Some(width)) = (pixels(height), pixels(width))
    {
        return Ok(CameraSpec {
            name: name.to_owned(),
            width,
            height,
            depth: None,
        });
    }
    let what = format!("the shape of {IMAGE_PREFIX}{name}");
    Err(mismatch(
        path.to_owned(),
        &what,
        format!("{:?}", feature.shape),
        format!("[height, width, 3], sides up to {SIDE_MAX}"),
    ))
}
