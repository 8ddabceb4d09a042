//! Needle lift: one arm grasps a suture needle that lies on an organ, lifts it and holds it up.
//!
//! Drawn for each episode: where the needle lies, by [`NeedleStart`], and nothing else unless it is
//! varied. There is no goal pose: up is enough.

mod script;
mod success;

use std::collections::BTreeMap;
use std::sync::Arc;

use hal::Pose;
use hal::config::{ConfigError, Source};
use serde::Deserialize;
use trocar_render::visual::{Backdrop, Visual, instance};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::{Organ, OrganShape};
use trocar_world::{ArmStart, Scenery, WorldConfig};

use script::Lifter;
pub use success::SuccessConfig;
use success::SuccessMonitor;

use super::common::{ArmFile, CommonFile, EpisodeFile, RenderingFile, TitleFile};
use super::patient::{self, Patient, SceneFile};
use super::visuals::{MUSCLE, NEEDLE_STEEL};
use super::{CameraConfig, Kind, Monitor, NeedleStart, Parsed, TaskScene};
use crate::script::AnyScript;
use crate::script::alone::Alone;

/// The name by which scene files know this kind of scene.
pub const NAME: &str = "needle-lift";

/// The needle that demonstrations are recorded with.
pub const TRAINED: &str = "N1";

pub(super) const KIND: Kind = Kind {
    name: NAME,
    arms: 1,
    parts: &[],
    parse,
};

/// The scene of a needle lift.
#[derive(Clone, Debug)]
pub struct NeedleLift {
    /// The needle of this episode: one of `needles`, the trained one unless another was chosen, or
    /// `[scene]` names one.
    pub needle: NeedleShape,
    /// The name of that one.
    pub needle_name: String,
    /// All needles by name.
    pub needles: BTreeMap<String, NeedleShape>,
    /// Where the needle may lie at the start.
    pub start: NeedleStart,
    /// What the needle lies on.
    pub organ: Organ,
    /// Whose organ that is, if it is a patient's.
    pub patient: Option<Arc<Patient>>,
    /// What counts as success.
    pub success: SuccessConfig,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "task")]
    _task: TitleFile,
    scene: Option<SceneFile>,
    episode: EpisodeFile,
    arm: Vec<ArmFile>,
    needle: BTreeMap<String, NeedleShape>,
    needle_start: NeedleStart,
    organ: OrganShape,
    world: WorldConfig,
    camera: Vec<CameraConfig>,
    #[serde(default)]
    rendering: RenderingFile,
    success: SuccessConfig,
}

fn parse(source: &Source) -> Result<Parsed, ConfigError> {
    let file: File = source.parse()?;
    for (name, needle) in &file.needle {
        needle.check(source, &format!("needle.{name}"))?;
    }
    if !file.needle.contains_key(TRAINED) {
        return Err(source.out_of_range("needle", "no such needle", TRAINED));
    }
    let named = file.scene.as_ref().and_then(|scene| scene.needle.clone());
    let name = named.unwrap_or_else(|| TRAINED.to_owned());
    let Some(&needle) = file.needle.get(&name) else {
        let known: Vec<&str> = file.needle.keys().map(String::as_str).collect();
        return Err(source.out_of_range("scene.needle", &name, &known.join(", ")));
    };
    file.needle_start.check(source)?;
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
    let (organ, patient) = patient::ground(source, &common, file.organ, scene, start, &needle)?;
    let scene = NeedleLift {
        needle,
        needle_name: name,
        needles: file.needle,
        start: file.needle_start,
        organ,
        patient,
        success: file.success,
    };
    Ok((common, Box::new(scene)))
}

impl TaskScene for NeedleLift {
    fn scenery(&self, seed: u64) -> Scenery {
        self.start.scenery(seed, &self.needle, &self.organ)
    }

    fn goal(&self, _seed: u64) -> Option<Pose> {
        None
    }

    fn monitor(&self, _seed: u64) -> Box<dyn Monitor> {
        Box::new(SuccessMonitor::new(
            &self.success,
            &self.needle,
            &self.organ,
        ))
    }

    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript> {
        Box::new(Alone::new(Lifter::new(self), arms, seed))
    }

    fn patient(&self) -> Option<&Patient> {
        self.patient.as_deref()
    }

    fn visuals(&self) -> Vec<Visual> {
        let muscle =
            |shape: &OrganShape| Visual::new("organ", shape.mesh(), MUSCLE, instance::ORGAN);
        let mut visuals = patient::visuals(&self.organ, self.patient(), muscle);
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
        patient::backdrop(self.patient(), Backdrop::CAVITY)
    }

    fn needle(&self) -> Option<&str> {
        Some(&self.needle_name)
    }

    fn needles(&self) -> Vec<String> {
        self.needles.keys().cloned().collect()
    }

    fn choose_needle(&mut self, name: &str) -> Result<(), Vec<String>> {
        let Some(&needle) = self.needles.get(name) else {
            return Err(self.needles());
        };
        self.needle = needle;
        name.clone_into(&mut self.needle_name);
        Ok(())
    }

    fn lies(&self) -> bool {
        self.start.has_place(&self.needle, &self.organ)
    }

    fn visual_poses(&self, things: &[Pose], _goal: &Pose) -> Vec<Pose> {
        patient::poses(self.patient(), things[0])
    }
}

#[cfg(test)]
impl NeedleLift {
    /// The scene as it ships.
    pub(crate) fn shipped() -> Self {
        let task = super::TaskConfig::shipped(NAME);
        task.scene::<Self>().unwrap().clone()
    }
}

#[cfg(test)]
mod tests;
