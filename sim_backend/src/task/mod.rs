//! Tasks as data: who stands where, what lies there, who looks, and what counts as success.
//!
//! Adding a task touches, and nothing else:
//! - a folder `config/tasks/TASK/` with `scene.toml` and `safety.toml`;
//! - a module here with its scene, its monitor and its `ENTRY`;
//! - in this file the module's line, a line in `ENTRIES`, and a variant of [`Scene`] with its lines in `Scene::of_task`,
//!   [`TaskConfig::needle`] and [`TaskConfig::with_needle`];
//! - a script in [`crate::expert`] with its variant in `AnyScript`;
//! - if it shows things of a new kind, their ids in [`crate::visual::instance`] and, in the contact sheet of the sessions, a
//!   name and a colour for each;
//! - tests: what the first camera shows of it (`simulation/pictures.rs`), and its script in closed loop
//!   (`expert/closed_loop/`).
//!
//! Names, command line, sheet and evaluations follow from `ENTRIES`, in its order.

pub mod block_transfer;
mod camera;
mod common;
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
use serde::Deserialize;

pub use camera::{CameraConfig, ENDOSCOPE, Mount, SIDE};
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
use needle_handover::NeedleHandover;
use needle_lift::NeedleLift;
use suture_pad::SuturePad;
use tissue_retraction::TissueRetraction;

/// Most arms that a task has.
pub const ARMS_MAX: usize = 2;

/// Most things that a task has.
pub const THINGS_MAX: usize = 2;

/// A task as the repository knows it.
struct Entry {
    name: &'static str,
    scene: BuiltIn,
    /// Where the instruments may be. Handed on to whoever controls them, never read here.
    safety: BuiltIn,
    parse: fn(&Source) -> Result<TaskConfig, ConfigError>,
}

/// A file that is built into the program, and where it lies in the repository.
struct BuiltIn {
    path: &'static str,
    text: &'static str,
}

impl BuiltIn {
    fn source(&self) -> Source {
        Source::embedded(self.path, self.text)
    }
}

/// All tasks.
const ENTRIES: [Entry; 5] = [
    needle_lift::ENTRY,
    needle_handover::ENTRY,
    tissue_retraction::ENTRY,
    suture_pad::ENTRY,
    block_transfer::ENTRY,
];

/// A task, checked.
#[derive(Clone, Debug)]
pub struct TaskConfig {
    /// The name by which the command line and the logs know it.
    pub name: &'static str,
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
    pub task: &'static str,
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

/// The part of a scene file that says what it is.
#[derive(Deserialize)]
struct Title {
    task: String,
}

impl TaskConfig {
    /// Names of all tasks.
    pub fn names() -> impl Iterator<Item = &'static str> {
        ENTRIES.iter().map(|entry| entry.name)
    }

    /// The text of a task as it ships, for logs and overrides; none if there is no such task.
    #[must_use]
    pub fn source(name: &str) -> Option<Source> {
        let entry = ENTRIES.iter().find(|entry| entry.name == name)?;
        Some(entry.scene.source())
    }

    /// The safety limits of a task as they ship, unread; none if there is no such task.
    #[must_use]
    pub fn safety_source(name: &str) -> Option<Source> {
        let entry = ENTRIES.iter().find(|entry| entry.name == name)?;
        Some(entry.safety.source())
    }

    /// The text of the needle lift as it ships.
    #[must_use]
    pub fn needle_lift_source() -> Source {
        needle_lift::ENTRY.scene.source()
    }

    /// The needle lift as it ships.
    ///
    /// # Errors
    /// [`ConfigError`] if the file that is built in is wrong.
    pub fn needle_lift() -> Result<Self, ConfigError> {
        Self::parse(&Self::needle_lift_source())
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

    /// Reads a scene file, whose key `task` says of which task.
    ///
    /// # Errors
    /// [`ConfigError`], naming line, key and allowed range.
    pub fn parse(source: &Source) -> Result<Self, ConfigError> {
        let title: Title = source.parse()?;
        let found = ENTRIES.iter().find(|entry| entry.name == title.task);
        let Some(entry) = found else {
            let known: Vec<_> = Self::names().collect();
            return Err(source.out_of_range("task", &title.task, &known.join(", ")));
        };
        (entry.parse)(source)
    }
}

#[cfg(test)]
mod tests;
