//! The needle lift as data: scene, start, cameras, and what counts as success.

mod camera;
mod start;
mod success;
mod visuals;

use hal::config::{ConfigError, Source};
use hal::{JOINT_COUNT, JointVector, Pose, psm};
use serde::Deserialize;

pub use camera::CameraConfig;
pub use start::NeedleStart;
pub use success::{Outcome, Reason, SuccessConfig, SuccessMonitor};
pub(crate) use visuals::{visual_poses, visuals};

use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::world::WorldConfig;

/// The name by which the command line and the logs know the task.
pub const NEEDLE_LIFT: &str = "needle-lift";

/// Path of the needle lift's scene in the repository.
pub const NEEDLE_LIFT_PATH: &str = "config/tasks/needle-lift/scene.toml";

/// A task, checked.
#[derive(Clone, Debug)]
pub struct TaskConfig {
    /// Scene frame from the arm's base frame (the RCM).
    pub scene_from_rcm: Pose,
    /// Joints of the arm at the start, rad (insertion m).
    pub joints0: JointVector,
    /// Jaw angle at the start, rad.
    pub jaw0: f64,
    /// The needle.
    pub needle: NeedleShape,
    /// Where the needle may lie at the start.
    pub needle_start: NeedleStart,
    /// What the needle lies on.
    pub organ: OrganShape,
    /// Drives and contact physics.
    pub world: WorldConfig,
    /// The cameras, in the order of observations.
    pub cameras: Vec<CameraConfig>,
    /// What counts as success.
    pub success: SuccessConfig,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    arm: ArmFile,
    needle: NeedleShape,
    needle_start: NeedleStart,
    organ: OrganShape,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    success: SuccessConfig,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmFile {
    rcm_in_scene_m: [f64; 3],
    joints: [f64; JOINT_COUNT],
    jaw_rad: f64,
}

impl TaskConfig {
    /// The needle lift as it ships.
    ///
    /// # Errors
    /// [`ConfigError`] if the file that is built in is wrong.
    pub fn needle_lift() -> Result<Self, ConfigError> {
        Self::parse(&Self::needle_lift_source())
    }

    /// The text of the needle lift as it ships, for logs and overrides.
    #[must_use]
    pub fn needle_lift_source() -> Source {
        Source::embedded(
            NEEDLE_LIFT_PATH,
            include_str!("../../../config/tasks/needle-lift/scene.toml"),
        )
    }

    /// Reads a scene file.
    ///
    /// # Errors
    /// [`ConfigError`], naming line, key and allowed range.
    pub fn parse(source: &Source) -> Result<Self, ConfigError> {
        let file: SceneFile = source.parse()?;
        check_arm(source, &file.arm)?;
        file.needle.check(source, "needle")?;
        file.organ.check(source, "organ")?;
        file.world.check(source, "world")?;
        file.needle_start.check(source)?;
        check_success(source, &file.success)?;
        if file.camera.is_empty() {
            return Err(source.out_of_range("camera", "no camera", "at least one"));
        }
        for (index, camera) in file.camera.iter().enumerate() {
            camera.check(source, index)?;
        }
        let [x, y, z] = file.arm.rcm_in_scene_m;
        Ok(Self {
            scene_from_rcm: Pose::translation(x, y, z),
            joints0: JointVector::from(file.arm.joints),
            jaw0: file.arm.jaw_rad,
            needle: file.needle,
            needle_start: file.needle_start,
            organ: file.organ,
            world: file.world,
            cameras: file.camera,
            success: file.success,
        })
    }
}

fn check_arm(source: &Source, arm: &ArmFile) -> Result<(), ConfigError> {
    for (axis, value) in arm.rcm_in_scene_m.into_iter().enumerate() {
        source.check_range(&format!("arm.rcm_in_scene_m.{axis}"), value, -1.0, 1.0)?;
    }
    for (joint, value) in arm.joints.into_iter().enumerate() {
        let key = format!("arm.joints.{joint}");
        source.check_range(
            &key,
            value,
            psm::POSITION_MIN[joint],
            psm::POSITION_MAX[joint],
        )?;
    }
    source.check_range("arm.jaw_rad", arm.jaw_rad, 0.0, psm::JAW_MAX)
}

fn check_success(source: &Source, success: &SuccessConfig) -> Result<(), ConfigError> {
    let check = |key: &str, value, low, high| {
        source.check_range(&format!("success.{key}"), value, low, high)
    };
    check("lift_height_m", success.lift_height_m, 0.005, 0.1)?;
    check("hold_s", success.hold_s, 0.05, 10.0)?;
    check("grip_force_n_min", success.grip_force_n_min, 0.0, 10.0)?;
    check("clearance_m", success.clearance_m, 0.0, 0.05)?;
    check("time_limit_s", success.time_limit_s, 1.0, 600.0)?;
    check(
        "penetration_m_max",
        success.penetration_m_max,
        0.000_01,
        0.01,
    )?;
    check(
        "needle_speed_m_s_max",
        success.needle_speed_m_s_max,
        0.05,
        10.0,
    )?;
    check("sink_m_max", success.sink_m_max, 0.001, 0.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The shipped file with one line replaced, and the number of that line.
    fn doctored(old: &str, new: &str) -> (Source, usize) {
        let text = TaskConfig::needle_lift_source().text().to_owned();
        let line = text
            .lines()
            .position(|line| line.starts_with(old))
            .expect("line to replace")
            + 1;
        let lines: Vec<&str> = text
            .lines()
            .map(|line| if line.starts_with(old) { new } else { line })
            .collect();
        (Source::embedded("scene.toml", &lines.join("\n")), line)
    }

    #[test]
    fn shipped_scene_is_valid_and_starts_above_the_organ() {
        let task = TaskConfig::needle_lift().unwrap();
        assert_eq!(task.cameras[0].name, "endoscope");
        assert_eq!((task.cameras[0].width, task.cameras[0].height), (512, 512));
        // Straight down at zero wrist angles: insertion less 6.5 mm below the RCM.
        let tip_z = task.scene_from_rcm.translation.z - (task.joints0[2] - 0.0065);
        let height = tip_z - task.organ.height_m(0.0, 0.0);
        assert!((0.04..0.05).contains(&height), "{height}");
    }

    #[test]
    fn unknown_key_is_named_with_its_line() {
        let (source, line) = doctored("jaw_rad", "jaw_rad = 0.6\nspeling = 1");
        let message = TaskConfig::parse(&source).unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("scene.toml:{}: ", line + 1))
                && message.contains("speling"),
            "{message}"
        );
    }

    #[test]
    fn value_out_of_range_is_named_with_line_key_and_range() {
        for (old, new, key) in [
            (
                "hold_s",
                "hold_s = -1.0",
                "success.hold_s = -1 is outside [0.05, 10]",
            ),
            ("mass_kg", "mass_kg = 5.0", "needle.mass_kg = 5 is outside"),
            (
                "vertical_fov_rad",
                "vertical_fov_rad = 4.0",
                "camera.0.vertical_fov_rad = 4 is outside",
            ),
            (
                "range_m",
                "range_m = [0.025, 0.5]",
                "needle_start.range_m.1 = 0.5 is outside",
            ),
            (
                "joints",
                "joints = [0.0, 0.0, 0.3, 0.0, 0.0, 0.0]",
                "arm.joints.2 = 0.3 is outside",
            ),
            ("up", "up = [0.0, 0.0, 2.0]", "camera.0.up.2 = 2 is outside"),
        ] {
            let (source, line) = doctored(old, new);
            let message = TaskConfig::parse(&source).unwrap_err().to_string();
            assert!(
                message.starts_with(&format!("scene.toml:{line}: {key}")),
                "{message}"
            );
        }
    }

    #[test]
    fn missing_camera_is_an_error() {
        let text = TaskConfig::needle_lift_source().text().to_owned();
        let (before, rest) = text.split_once("[[camera]]").unwrap();
        let after = &rest[rest.find("\n[success]").unwrap()..];
        let source = Source::embedded("scene.toml", &format!("camera = []\n{before}{after}"));
        let message = TaskConfig::parse(&source).unwrap_err().to_string();
        assert!(
            message.contains("camera = no camera is outside at least one"),
            "{message}"
        );
    }
}
