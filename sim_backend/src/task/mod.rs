//! Tasks as data: who stands where, what lies there, who looks, and what counts as success.
//!
//! A task is a folder with `scene.toml` and `safety.toml`, and its name is the folder's. Adding one touches that folder and
//! nothing else: those in `config/tasks/` are built in, any other folder is a task as well, given its path.
//!
//! What a scene file describes is said by its `task.kind`. Adding a kind touches:
//! - a module here with its scene, its monitor and its `KIND`;
//! - in this file the module's line, a line in `KINDS`, and a variant of [`Scene`] with its lines in `Scene::of_task`,
//!   [`TaskConfig::needle`] and [`TaskConfig::with_needle`];
//! - a script in [`crate::expert`] with its variant in `AnyScript`;
//! - if it shows things of a new sort, their ids in [`crate::visual::instance`] and, in the contact sheet of the sessions, a
//!   name and a colour for each;
//! - tests: what the first camera shows of it (`simulation/pictures.rs`), and its script in closed loop
//!   (`expert/closed_loop/`).

pub mod block_transfer;
mod camera;
mod common;
mod files;
mod judge;
pub mod needle_handover;
pub mod needle_lift;
mod needle_start;
pub mod suture_pad;
pub mod tissue_retraction;
mod view;
mod visuals;

use hal::Pose;
use hal::config::{ConfigError, Source};

pub use camera::{CameraConfig, ENDOSCOPE, Mount, SIDE};
pub use files::{SAFETY_FILE, SCENE_FILE, TaskError, TaskFiles};
pub(crate) use judge::{Judge, Monitor, Sight};
pub use judge::{Outcome, Reason};
pub use needle_start::NeedleStart;
pub use view::{NoSuchView, VIEW1_SHIFT_M, VIEW1_TURN_RAD, View};
pub(crate) use visuals::{scene_poses, scene_visuals};

use crate::render::Shading;
use crate::tissue::TissueConfig;
use crate::visual::{Backdrop, Visual};
use crate::world::{ArmStart, Scenery, WorldConfig};
use block_transfer::BlockTransfer;
use common::CommonFile;
use needle_handover::NeedleHandover;
use needle_lift::NeedleLift;
use suture_pad::SuturePad;
use tissue_retraction::TissueRetraction;

/// Most arms that a task has.
pub const ARMS_MAX: usize = 2;

/// Most things that a task has.
pub const THINGS_MAX: usize = 2;

/// A kind of scene: what a scene file describes, and how that is done and judged.
struct Kind {
    /// The name by which scene files know it.
    name: &'static str,
    /// How many arms it has.
    arms: usize,
    /// Reads what is particular to it, and checks that.
    parse: fn(&Source) -> Result<(CommonFile, Scene), ConfigError>,
}

/// All kinds.
const KINDS: [Kind; 5] = [
    block_transfer::KIND,
    needle_handover::KIND,
    needle_lift::KIND,
    suture_pad::KIND,
    tissue_retraction::KIND,
];

/// A task, checked.
#[derive(Clone, Debug)]
pub struct TaskConfig {
    /// The name by which results, logs and datasets know it.
    pub name: String,
    /// The kind of its scene.
    pub kind: &'static str,
    /// The arms, the one that a one-armed driver drives first.
    pub arms: Vec<ArmStart>,
    /// Drives and contact physics.
    pub world: WorldConfig,
    /// The cameras, in the order of observations.
    pub cameras: Vec<CameraConfig>,
    /// How the cameras stand against the file; see [`Self::with_view`].
    pub view: View,
    /// How much work goes into pictures.
    pub shading: Shading,
    /// When the episode ends without success, s.
    pub time_limit_s: f64,
    /// What is particular to the task.
    pub scene: Scene,
}

/// What is particular to each task.
#[derive(Clone, Debug)]
pub enum Scene {
    /// One arm lifts a needle.
    NeedleLift(NeedleLift),
    /// One arm moves a block from peg to peg.
    BlockTransfer(BlockTransfer),
    /// One arm drives a needle through a hole.
    SuturePad(SuturePad),
    /// Two arms pass a needle.
    NeedleHandover(NeedleHandover),
    /// One arm lifts a flap of skin.
    TissueRetraction(TissueRetraction),
}

/// What a task's module answers. Everything that is drawn at random hangs on `seed`.
pub(crate) trait TaskScene {
    /// Things at their places, and the ground.
    fn scenery(&self, world: &WorldConfig, seed: u64) -> Scenery;

    /// The place where something is to be brought, scene frame, if the task has one.
    fn goal(&self, seed: u64) -> Option<Pose>;

    /// A judge of the episode, at its start.
    fn monitor(&self, seed: u64) -> Box<dyn Monitor>;

    /// What there is to see besides the arms.
    fn visuals(&self) -> Vec<Visual>;

    /// What is behind that.
    fn backdrop(&self) -> Backdrop {
        Backdrop::CAVITY
    }

    /// Where the visuals are, in the same order, in the scene frame.
    fn visual_poses(&self, things: &[Pose], goal: &Pose) -> Vec<Pose>;

    /// The soft flap, if there is one, with the radius of its mark, m. Its visuals are those with the instance ids
    /// [`crate::visual::instance::TISSUE`] and [`crate::visual::instance::MARK`].
    fn flap(&self) -> Option<(&TissueConfig, f64)> {
        None
    }
}

impl Scene {
    pub(crate) const fn of_task(&self) -> &dyn TaskScene {
        match self {
            Self::NeedleLift(scene) => scene,
            Self::BlockTransfer(scene) => scene,
            Self::SuturePad(scene) => scene,
            Self::NeedleHandover(scene) => scene,
            Self::TissueRetraction(scene) => scene,
        }
    }
}

/// A needle was asked for that a task does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{task} has no needle {name:?}; {}", known_needles(known))]
pub struct NoSuchNeedle {
    /// The task.
    pub task: String,
    /// The needle asked for.
    pub name: String,
    /// The needles that can be chosen.
    pub known: Vec<String>,
}

fn known_needles(known: &[String]) -> String {
    if known.is_empty() {
        "it has no choice of needles".to_owned()
    } else {
        format!("it has {}", known.join(", "))
    }
}

impl TaskConfig {
    /// Names of the built-in tasks.
    pub fn names() -> impl Iterator<Item = &'static str> {
        files::names()
    }

    /// The built-in task `name`.
    ///
    /// # Errors
    /// [`TaskError::Unknown`], or [`TaskError::Config`] if its file is wrong.
    pub fn built_in(name: &str) -> Result<Self, TaskError> {
        let files = TaskFiles::built_in(name).ok_or_else(|| TaskError::unknown(name))?;
        Ok(files.config()?)
    }

    /// The name of the needle of this task, if there is a choice.
    #[must_use]
    pub fn needle(&self) -> Option<&str> {
        match &self.scene {
            Scene::NeedleLift(scene) => Some(&scene.needle_name),
            Scene::BlockTransfer(_)
            | Scene::SuturePad(_)
            | Scene::NeedleHandover(_)
            | Scene::TissueRetraction(_) => None,
        }
    }

    /// The same task with another needle, by the name that the scene file gives it.
    ///
    /// # Errors
    /// [`NoSuchNeedle`], also for a task that has no choice of needles.
    pub fn with_needle(mut self, name: &str) -> Result<Self, NoSuchNeedle> {
        let known = match &mut self.scene {
            Scene::NeedleLift(scene) => {
                if let Some(&needle) = scene.needles.get(name) {
                    scene.needle = needle;
                    name.clone_into(&mut scene.needle_name);
                    return Ok(self);
                }
                scene.needles.keys().cloned().collect()
            }
            Scene::BlockTransfer(_)
            | Scene::SuturePad(_)
            | Scene::NeedleHandover(_)
            | Scene::TissueRetraction(_) => Vec::new(),
        };
        Err(NoSuchNeedle {
            task: self.name,
            name: name.to_owned(),
            known,
        })
    }

    /// Reads the scene file of the task `name`, whose `task.kind` says what it describes.
    ///
    /// # Errors
    /// [`ConfigError`], naming line, key and allowed range.
    pub fn parse(name: &str, source: &Source) -> Result<Self, ConfigError> {
        let asked = files::title(source)?.kind;
        let Some(kind) = KINDS.iter().find(|kind| kind.name == asked) else {
            let known = KINDS.map(|kind| kind.name).join(", ");
            return Err(source.out_of_range("task.kind", &asked, &known));
        };
        let (common, scene) = (kind.parse)(source)?;
        common.into_task(source, name, kind, scene)
    }
}

#[cfg(test)]
impl TaskConfig {
    /// A built-in task.
    pub(crate) fn shipped(name: &str) -> Self {
        Self::built_in(name).unwrap()
    }
}

#[cfg(test)]
mod tests;
