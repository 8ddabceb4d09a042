//! What every scene file says: arms, physics, cameras, time.

use core::f64::consts::PI;

use hal::config::{ConfigError, Source};
use hal::{JOINT_COUNT, JointVector, Pose, psm};
use nalgebra::{Translation3, UnitQuaternion};
use serde::Deserialize;
use trocar_render::Shading;
use trocar_world::{ArmStart, Scenery, WorldConfig};

use super::{
    CameraConfig, Kind, Monitor, MonitorInput, Outcome, TaskConfig, TaskScene, View, laying,
};

/// For how long a scene is watched before an arm moves, ms.
const STILL_STEPS: u32 = 500;

/// `[task]`.
#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table [task] that has `kind`")]
pub(super) struct TitleFile {
    /// The kind of scene.
    pub(super) kind: String,
    /// The place in lists of tasks, from the front; at their end if not given.
    pub(super) order: Option<u32>,
}

/// One `[[arm]]`.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmFile {
    /// The remote centre of motion, scene frame, m.
    rcm_in_scene_m: [f64; 3],
    /// How the arm's base frame is turned in the scene: about x, then y, then z of the scene, rad.
    rcm_in_scene_rpy_rad: [f64; 3],
    /// Joints at the start, rad (insertion m).
    joints: [f64; JOINT_COUNT],
    /// Jaw angle at the start, rad.
    jaw_rad: f64,
}

/// `[episode]`.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EpisodeFile {
    /// When the episode ends without success, s.
    time_limit_s: f64,
}

/// `[rendering]`, which a scene file may leave out.
#[derive(Clone, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct RenderingFile {
    /// "full", "fine" or "plain".
    shading: Option<String>,
}

impl RenderingFile {
    fn shading(&self, source: &Source) -> Result<Shading, ConfigError> {
        match self.shading.as_deref() {
            None | Some("full") => Ok(Shading::Full),
            Some("fine") => Ok(Shading::Fine),
            Some("plain") => Ok(Shading::Plain),
            Some(other) => {
                Err(source.out_of_range("rendering.shading", other, "full, fine, plain"))
            }
        }
    }
}

/// The tables that all scene files share. Each kind's file lists them among its own, since `serde`
/// does not flatten into a table that refuses unknown keys.
pub(super) struct CommonFile {
    pub(super) arm: Vec<ArmFile>,
    pub(super) world: WorldConfig,
    pub(super) camera: Vec<CameraConfig>,
    pub(super) rendering: RenderingFile,
    pub(super) episode: EpisodeFile,
}

/// What they say, checked. Lives between reading a scene file and [`Self::into_task`], so that a
/// kind can try its needle in the file's own world before there is a task.
pub(super) struct Common {
    arms: Vec<ArmStart>,
    world: WorldConfig,
    cameras: Vec<CameraConfig>,
    shading: Shading,
    time_limit_s: f64,
}

impl CommonFile {
    /// Checks everything; scenes of the kind have so many `arms`.
    pub(super) fn check(self, source: &Source, arms: usize) -> Result<Common, ConfigError> {
        if self.arm.len() != arms {
            let found = format!("{} arms", self.arm.len());
            return Err(source.out_of_range("arm", &found, &arms.to_string()));
        }
        for (index, arm) in self.arm.iter().enumerate() {
            arm.check(source, index)?;
        }
        self.world.check(source, "world")?;
        CameraConfig::check_all(&self.camera, source, self.arm.len())?;
        source.check_range(
            "episode.time_limit_s",
            self.episode.time_limit_s,
            1.0,
            86_400.0,
        )?;
        Ok(Common {
            arms: self.arm.iter().map(ArmFile::start).collect(),
            world: self.world,
            shading: self.rendering.shading(source)?,
            cameras: self.camera,
            time_limit_s: self.episode.time_limit_s,
        })
    }
}

impl Common {
    /// Checks that the needle of `scenery` comes to rest on the patient's `organ`.
    pub(super) fn check_rests(
        &self,
        source: &Source,
        organ: &str,
        scenery: impl Fn(u64) -> Scenery,
    ) -> Result<(), ConfigError> {
        if laying::rests(&self.world, &self.arms, scenery) {
            return Ok(());
        }
        let reason = "its needle slides off; a smaller one may lie";
        Err(source.refused("scene.organ", organ, reason))
    }

    /// How an episode of `scenery` ends by `monitor` in its first [`STILL_STEPS`], in which no arm
    /// moves; none if it goes on, as it should.
    pub(super) fn ends_at_once(
        &self,
        scenery: &Scenery,
        monitor: &mut dyn Monitor,
    ) -> Option<Outcome> {
        let mut world = laying::after_settling(&self.world, &self.arms, scenery);
        (0..STILL_STEPS).find_map(|_| {
            world.step();
            let outcome = monitor.observe(&MonitorInput::of(&world));
            (outcome != Outcome::Running).then_some(outcome)
        })
    }

    /// The task of the given `name` and `kind`.
    pub(super) fn into_task(
        self,
        name: &str,
        kind: &Kind,
        scene: Box<dyn TaskScene>,
    ) -> TaskConfig {
        TaskConfig {
            name: name.to_owned(),
            kind: kind.name,
            arms: self.arms,
            world: self.world,
            shading: self.shading,
            cameras: self.cameras,
            view: View::Train,
            varied: Vec::new(),
            needles_drawn: Vec::new(),
            time_limit_s: self.time_limit_s,
            scene,
        }
    }
}

impl ArmFile {
    /// Places within 1 m of the scene's origin, joints and jaw within the instrument's limits.
    fn check(&self, source: &Source, index: usize) -> Result<(), ConfigError> {
        let key = |name: &str| format!("arm.{index}.{name}");
        for axis in 0..3 {
            let (place, turn) = (self.rcm_in_scene_m[axis], self.rcm_in_scene_rpy_rad[axis]);
            source.check_range(&key(&format!("rcm_in_scene_m.{axis}")), place, -1.0, 1.0)?;
            source.check_range(&key(&format!("rcm_in_scene_rpy_rad.{axis}")), turn, -PI, PI)?;
        }
        for (joint, value) in self.joints.into_iter().enumerate() {
            source.check_range(
                &key(&format!("joints.{joint}")),
                value,
                psm::POSITION_MIN[joint],
                psm::POSITION_MAX[joint],
            )?;
        }
        source.check_range(&key("jaw_rad"), self.jaw_rad, 0.0, psm::JAW_MAX)
    }

    fn start(&self) -> ArmStart {
        let [roll, pitch, yaw] = self.rcm_in_scene_rpy_rad;
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        ArmStart {
            scene_from_rcm: Pose::from_parts(Translation3::from(self.rcm_in_scene_m), turn),
            joints: JointVector::from(self.joints),
            jaw: self.jaw_rad,
        }
    }
}
