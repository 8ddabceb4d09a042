//! Needle handover: the right arm grasps a needle that lies on the liver and presents it, the left
//! one takes it away.
//!
//! Drawn for each episode: where the needle lies, by [`NeedleStart`]. The goal is where the script
//! presents it, [`Presented`]; the judge does not ask for that place.

mod script;
mod success;

use std::sync::Arc;

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Visual, instance};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::{Organ, OrganShape};
use trocar_world::{ArmStart, Scenery, WorldConfig};

use script::Passer;
pub use success::SuccessConfig;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::patient::{self, Patient, SceneFile};
use super::visuals::{LIVER, NEEDLE_STEEL};
use super::{CameraConfig, Kind, Monitor, NeedleStart, Parsed, TaskScene};
use crate::script::AnyScript;

/// The name by which scene files know this kind of scene.
pub const NAME: &str = "needle-handover";

pub(super) const KIND: Kind = Kind {
    name: NAME,
    arms: 2,
    parts: &[],
    parse,
};

/// The scene of a needle handover. The first arm is the right one, which gives.
#[derive(Clone, Debug)]
pub struct NeedleHandover {
    /// The needle.
    pub needle: NeedleShape,
    /// Where the needle may lie at the start.
    pub start: NeedleStart,
    /// Where the needle is to be presented.
    pub presented: Presented,
    /// What the needle lies on.
    pub organ: Organ,
    /// Whose organ that is, if it is a patient's.
    pub patient: Option<Arc<Patient>>,
    /// What counts as success.
    pub success: SuccessConfig,
}

/// Where the needle is to be presented, flat.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Presented {
    /// Centre of the needle's arc, scene frame, m.
    pub centre_m: [f64; 3],
    /// Rotation of the needle about the vertical, rad; at 0 its arc bulges towards +x.
    pub yaw_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "task")]
    _task: TitleFile,
    scene: Option<SceneFile>,
    episode: EpisodeFile,
    arm: Vec<ArmFile>,
    needle: NeedleShape,
    needle_start: NeedleStart,
    presented: Presented,
    organ: OrganShape,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    #[serde(default)]
    rendering: RenderingFile,
    success: SuccessConfig,
}

fn parse(source: &Source) -> Result<Parsed, ConfigError> {
    let file: File = source.parse()?;
    file.needle.check(source, "needle")?;
    file.needle_start.check(source)?;
    for (axis, value) in file.presented.centre_m.into_iter().enumerate() {
        source.check_range(&format!("presented.centre_m.{axis}"), value, -0.05, 0.1)?;
    }
    source.check_range("presented.yaw_rad", file.presented.yaw_rad, -3.2, 3.2)?;
    file.success.check(source)?;
    let common = CommonFile {
        arm: file.arm,
        world: file.world,
        camera: file.camera,
        rendering: file.rendering,
        episode: file.episode,
    }
    .check(source, KIND.arms)?;
    let start = &file.needle_start;
    let scene = file.scene.as_ref();
    patient::without_choice(source, scene)?;
    let (organ, patient) =
        patient::ground(source, &common, file.organ, scene, start, &file.needle)?;
    let scene = NeedleHandover {
        needle: file.needle,
        start: file.needle_start,
        presented: file.presented,
        organ,
        patient,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

impl TaskScene for NeedleHandover {
    fn scenery(&self, seed: u64) -> Scenery {
        self.start.scenery(seed, &self.needle, &self.organ)
    }

    fn goal(&self, _seed: u64) -> Option<Pose> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.presented.yaw_rad);
        let centre = Translation3::from(self.presented.centre_m);
        Some(Pose::from_parts(centre, turn))
    }

    fn monitor(&self, _seed: u64) -> Box<dyn Monitor> {
        Box::new(SuccessMonitor::new(self))
    }

    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript> {
        Box::new(Passer::new(self, arms, seed))
    }

    fn patient(&self) -> Option<&Patient> {
        self.patient.as_deref()
    }

    fn visuals(&self) -> Vec<Visual> {
        let liver =
            |shape: &OrganShape| Visual::new("liver", shape.lobed_mesh(), LIVER, instance::ORGAN);
        let mut visuals = patient::visuals(&self.organ, self.patient(), liver);
        let needle = self.needle.mesh();
        visuals.push(Visual::new(
            "needle",
            needle,
            NEEDLE_STEEL,
            instance::NEEDLE,
        ));
        visuals
    }

    fn backdrop(&self) -> Backdrop {
        let over_liver = Backdrop {
            bounce: [0.20, 0.045, 0.03],
            ..Backdrop::CAVITY
        };
        patient::backdrop(self.patient(), over_liver)
    }

    fn visual_poses(&self, things: &[Pose], _goal: &Pose) -> Vec<Pose> {
        patient::poses(self.patient(), things[0])
    }
}

#[cfg(test)]
impl NeedleHandover {
    /// The scene as it ships.
    pub(crate) fn shipped() -> Self {
        let task = super::TaskConfig::shipped(NAME);
        task.scene::<Self>().unwrap().clone()
    }
}

#[cfg(test)]
mod tests;
