//! What a recording refuses: descriptions and frames that could not be read back.

use hal::ARM_NAMES;

use super::{ArmFrame, CameraSpec, DatasetError, DatasetSpec, SIDE_MAX};

/// Only what can be stored and read back.
///
/// Runs before the folder is touched: at least one frame a second, one or two arms, cameras whose
/// names differ and whose sides are read back.
pub(super) fn check_spec(spec: &DatasetSpec) -> Result<(), DatasetError> {
    if spec.fps == 0 {
        return Err(input("fps", "0", "at least 1"));
    }
    if !(1..=ARM_NAMES.len()).contains(&spec.arms) {
        let allowed = format!("1 to {}", ARM_NAMES.len());
        return Err(input(
            "the number of arms",
            &spec.arms.to_string(),
            &allowed,
        ));
    }
    for (index, camera) in spec.cameras.iter().enumerate() {
        check_camera(camera, &spec.cameras[..index])?;
    }
    Ok(())
}

/// Name and size of a camera, whose name none of those `before` has.
fn check_camera(camera: &CameraSpec, before: &[CameraSpec]) -> Result<(), DatasetError> {
    let what = format!("camera \"{}\"", camera.name);
    if camera.name.is_empty() || camera.name.contains(['/', '\\']) {
        let expected = "a name without '/' and '\\'";
        return Err(input(&what, "no name for a feature", expected));
    }
    let sides = 1..=SIDE_MAX;
    if !sides.contains(&camera.width) || !sides.contains(&camera.height) {
        let found = format!("{} x {}", camera.width, camera.height);
        let expected = format!("sides of 1 to {SIDE_MAX} pixels");
        return Err(input(&what, &found, &expected));
    }
    if before.iter().any(|other| other.name == camera.name) {
        return Err(input(&what, "there twice", "there once"));
    }
    Ok(())
}

/// Only what a video with halved colour can hold. `yuv420p` has one colour sample for every 2 x 2
/// pixels, so both sides must be even.
pub(super) fn check_video(spec: &DatasetSpec) -> Result<(), DatasetError> {
    let even = |camera: &super::CameraSpec| {
        camera.width.is_multiple_of(2) && camera.height.is_multiple_of(2)
    };
    match spec.cameras.iter().find(|camera| !even(camera)) {
        None => Ok(()),
        Some(camera) => Err(input(
            &format!("camera \"{}\"", camera.name),
            &format!("{} x {}", camera.width, camera.height),
            "even sides, for video",
        )),
    }
}

/// As many arms as the dataset has, and every number finite.
///
/// Whether a pose is reachable or a quaternion of unit length is not checked here; imports do that.
pub(super) fn check_arms(spec: &DatasetSpec, arms: &[ArmFrame]) -> Result<(), DatasetError> {
    if arms.len() != spec.arms {
        let found = format!("of {} arms", arms.len());
        return Err(input("the frame", &found, &spec.arms.to_string()));
    }
    for (arm, name) in arms.iter().zip(ARM_NAMES) {
        let place = |what: &str| match spec.arms {
            1 => what.to_owned(),
            _ => format!("{name} {what}"),
        };
        check_finite(&place("state"), arm.state.map(f64::from))?;
        check_finite(&place("tip_pose"), arm.tip_pose)?;
        check_finite(&place("action"), arm.action)?;
    }
    Ok(())
}

/// The error names the vector and the index in it, such as `psm2 action[3]`.
fn check_finite<const N: usize>(what: &str, values: [f64; N]) -> Result<(), DatasetError> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(input(
            &format!("{what}[{index}]"),
            &values[index].to_string(),
            "a finite number",
        )),
        None => Ok(()),
    }
}

/// The error that `what` is `found` where `expected` would do.
pub(super) fn input(what: &str, found: &str, expected: &str) -> DatasetError {
    DatasetError::Input {
        what: what.to_owned(),
        found: found.to_owned(),
        expected: expected.to_owned(),
    }
}
