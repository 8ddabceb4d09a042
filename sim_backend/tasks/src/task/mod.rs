//! Tasks as data: who stands where, what lies there, who looks, and what counts as success.
//!
//! **A task** is a folder with `scene.toml` and `safety.toml`, and its name is the folder's. Adding
//! one touches that folder and nothing else, no line of code and no list: those in `config/tasks/`
//! are built in, any other folder is a task as well, given its path. What a scene file describes is
//! said by its `task.kind`.
//!
//! **A kind of scene** is a folder here: its scene and what is drawn at random, its monitor, its
//! expert's script, the parts that it alone shows, and the tests of all that. Adding one touches
//! that folder and two lines of this file, the module's and the one in `KINDS`; and a folder of the
//! first sort, whose task has that kind. Everything else sees kinds through `TaskScene` and tasks
//! through [`TaskConfig`].
//!
//! **Frames.** The scene frame has z up, in metres, with the ground near z = 0; things, cameras,
//! goals and what judges see are in it. Each arm has an RCM frame, its base, which
//! `ArmStart::scene_from_rcm` puts into the scene; what an expert is told and what it wants is in
//! that of the arm, and scripts turn both into the scene frame and back. A needle's frame has its
//! origin in the centre of the arc, the middle of the wire on +x and the point at y > 0; a block's
//! is in its middle, z along the hole; a mark's has y towards the free edge and z out of the
//! tissue.
//!
//! **Chance.** One number, the episode's seed, decides everything that is drawn. Each use draws
//! from a stream of its own, by the seed and a name (`needle`, `pegs`, `block`, `mark`, `expert`,
//! `light`, `lens NAME`, ...): a new random quantity leaves the old ones as they were. Arms always
//! start at the joints of the file.

pub mod block_transfer;
mod camera;
mod common;
mod criteria;
mod files;
mod judge;
pub(crate) mod laying;
pub mod needle_handover;
pub mod needle_lift;
mod needle_start;
mod outcome;
mod patient;
pub mod suture_pad;
pub mod tissue_retraction;
mod variation;
mod view;
mod visuals;

use core::any::Any;
use core::fmt::Debug;

use hal::Pose;
use hal::config::{ConfigError, Source};
use trocar_render::Shading;
use trocar_render::visual::{Backdrop, PARTS, Part, Visual};
use trocar_world::tissue::TissueConfig;
use trocar_world::{ArmStart, Scenery, WorldConfig};

pub use camera::{Calibration, CameraConfig, ENDOSCOPE, Mount, SIDE};
pub use criteria::{CRITERIA_MAX, Criteria, Criterion};
pub use files::{SAFETY_FILE, SCENE_FILE, TaskError, TaskFiles};
pub(crate) use judge::{Judge, Monitor, MonitorInput};
pub use needle_start::NeedleStart;
pub use outcome::{Outcome, Reason};
pub use patient::{Patient, PatientPlacement, patient_file, tissue_material};
pub use variation::{Appearance, CannotVary, Drawn, Lens, Variation};
pub use view::{NoSuchView, VIEW1_SHIFT_M, VIEW1_TURN_RAD, View};
pub(crate) use visuals::{arms_poses, arms_visuals, scene_poses, scene_visuals};

use crate::script::AnyScript;
use common::Common;

/// What a scene file says: what all kinds share, and the rest.
type Parsed = (Common, Box<dyn TaskScene>);

/// A kind of scene: what a scene file describes, and how that is done and judged.
struct Kind {
    /// The name by which scene files know it.
    name: &'static str,
    /// How many arms it has.
    arms: usize,
    /// What it alone shows, each with a unique instance id.
    parts: &'static [Part],
    /// Reads what is particular to it, and checks that.
    parse: fn(&Source) -> Result<Parsed, ConfigError>,
}

/// All kinds.
static KINDS: &[Kind] = &[
    block_transfer::KIND,
    needle_handover::KIND,
    needle_lift::KIND,
    suture_pad::KIND,
    tissue_retraction::KIND,
];

/// What instance ids mean, in scenes of all kinds.
pub fn parts() -> impl Iterator<Item = &'static Part> {
    let own = KINDS.iter().flat_map(|kind| kind.parts);
    PARTS.iter().chain(own)
}

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
    /// What is drawn anew for each episode; see [`Self::with_variations`].
    pub varied: Vec<Variation>,
    /// The needles that [`Variation::Needles`] draws from: those of the scene that come to rest on
    /// its ground.
    pub(crate) needles_drawn: Vec<String>,
    /// How much work goes into pictures.
    pub shading: Shading,
    /// When the episode ends without success, s.
    pub time_limit_s: f64,
    /// What is particular to the task.
    pub(crate) scene: Box<dyn TaskScene>,
}

/// What is particular to a kind of scene. Everything that is drawn at random depends on `seed`.
pub(crate) trait TaskScene: Any + CloneScene + Debug + Send + Sync {
    /// Things at their places, and the ground. On a patient it is also asked with numbers that are
    /// no episode's, for another place of a thing that slides off: only the places of things may
    /// then differ from those of the seed.
    fn scenery(&self, seed: u64) -> Scenery;

    /// The place where something is to be brought, scene frame, if the task has one.
    fn goal(&self, seed: u64) -> Option<Pose>;

    /// A judge of the episode, at its start. It must judge by what the world shows, not by where
    /// things started: a thing may have been laid elsewhere.
    fn monitor(&self, seed: u64) -> Box<dyn Monitor>;

    /// The scripted expert, which drives `arms`.
    fn expert(&self, arms: &[ArmStart], seed: u64) -> Box<dyn AnyScript>;

    /// The name of the needle, if there is a choice.
    fn needle(&self) -> Option<&str> {
        None
    }

    /// The names of all needles, if there is a choice.
    fn needles(&self) -> Vec<String> {
        Vec::new()
    }

    /// Takes the needle `name`, or answers with those that can be chosen.
    fn choose_needle(&mut self, _name: &str) -> Result<(), Vec<String>> {
        Err(Vec::new())
    }

    /// Whether its needle, if there is a choice, has a place to lie on its ground.
    fn lies(&self) -> bool {
        true
    }

    /// The patient whose organ is the ground, if it is one's.
    fn patient(&self) -> Option<&Patient> {
        None
    }

    /// What there is to see besides the arms. As many, in the same order, for every seed and
    /// needle: renderers keep them between episodes.
    fn visuals(&self) -> Vec<Visual>;

    /// What is behind that.
    fn backdrop(&self) -> Backdrop {
        Backdrop::CAVITY
    }

    /// Where the visuals are, in the same order, in the scene frame. `things` may be longer than
    /// what the scene has; a scene without a goal ignores `goal`.
    fn visual_poses(&self, things: &[Pose], goal: &Pose) -> Vec<Pose>;

    /// The soft flap, if there is one, with the radius of its mark, m. Its visuals are those with
    /// the instance ids [`trocar_render::visual::instance::TISSUE`] and
    /// [`trocar_render::visual::instance::MARK`].
    fn flap(&self) -> Option<(&TissueConfig, f64)> {
        None
    }
}

/// Scenes can be cloned behind their trait.
pub(crate) trait CloneScene {
    /// Another one.
    fn boxed(&self) -> Box<dyn TaskScene>;
}

impl<S: TaskScene + Clone> CloneScene for S {
    fn boxed(&self) -> Box<dyn TaskScene> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn TaskScene> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// The requested needle is not available.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NeedleError {
    /// The task does not have it.
    #[error("{task} has no needle {name:?}; {}", known_needles(known))]
    Unknown {
        /// The task.
        task: String,
        /// The requested needle.
        name: String,
        /// The needles that can be chosen.
        known: Vec<String>,
    },
    /// It does not lie on the chosen patch of the patient's organ, or slides off.
    #[error(
        "needle {name} does not lie on, or slides off, the chosen patch of the patient's {organ}; {}",
        resting_needles(resting)
    )]
    SlidesOff {
        /// The requested needle.
        name: String,
        /// The organ.
        organ: String,
        /// The needles that come to rest on it.
        resting: Vec<String>,
    },
}

/// The end of [`NeedleError::Unknown`]'s message.
fn known_needles(known: &[String]) -> String {
    if known.is_empty() {
        "it has no choice of needles".to_owned()
    } else {
        format!("it has {}", known.join(", "))
    }
}

/// The end of [`NeedleError::SlidesOff`]'s message.
fn resting_needles(resting: &[String]) -> String {
    if resting.is_empty() {
        "no other comes to rest there".to_owned()
    } else {
        format!("these come to rest there: {}", resting.join(", "))
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

    /// What is particular to the task, if its kind's is a `T`.
    #[must_use]
    pub fn scene<T: Any>(&self) -> Option<&T> {
        let scene: &dyn Any = &*self.scene;
        scene.downcast_ref()
    }

    /// The same, to be changed.
    pub fn scene_mut<T: Any>(&mut self) -> Option<&mut T> {
        let scene: &mut dyn Any = &mut *self.scene;
        scene.downcast_mut()
    }

    /// The name of the needle of this task, if there is a choice.
    #[must_use]
    pub fn needle(&self) -> Option<&str> {
        self.scene.needle()
    }

    /// How the patient lies whose organ is the ground; none if the ground is made up.
    #[must_use]
    pub fn patient(&self) -> Option<&PatientPlacement> {
        self.scene.patient().map(|patient| &patient.lie)
    }

    /// The same task with another needle, by the name that the scene file gives it. On a patient it
    /// must lie and come to rest on the patch that was chosen for the scene's own.
    ///
    /// # Errors
    /// [`NeedleError`], also for a task that has no choice of needles.
    pub fn with_needle(mut self, name: &str) -> Result<Self, NeedleError> {
        if let Err(known) = self.scene.choose_needle(name) {
            return Err(NeedleError::Unknown {
                task: self.name,
                name: name.to_owned(),
                known,
            });
        }
        if self.rests(&*self.scene) {
            return Ok(self);
        }
        let organ = self.patient().map(|lie| lie.organ.clone());
        Err(NeedleError::SlidesOff {
            name: name.to_owned(),
            organ: organ.unwrap_or_default(),
            resting: self.resting_needles(),
        })
    }

    /// The names of those needles of the scene that lie and come to rest on its ground, if there is
    /// a choice. On a patient each is laid and simulated, which takes a while.
    fn resting_needles(&self) -> Vec<String> {
        let rests = |name: &String| {
            let mut scene = self.scene.clone();
            scene.choose_needle(name).is_ok() && self.rests(&*scene)
        };
        let mut needles = self.scene.needles();
        needles.retain(rests);
        needles
    }

    /// Whether what starts in `scene` lies on its ground and comes to rest; made-up ground is so
    /// flat that it does.
    fn rests(&self, scene: &dyn TaskScene) -> bool {
        scene.patient().is_none()
            || (scene.lies() && laying::rests(&self.world, &self.arms, |seed| scene.scenery(seed)))
    }

    /// Reads the scene file of the task `name`, whose `task.kind` says what it describes.
    ///
    /// # Errors
    /// [`ConfigError`], naming line, key and allowed range.
    pub fn parse(name: &str, source: &Source) -> Result<Self, ConfigError> {
        let asked = files::title(source)?.kind;
        let Some(kind) = KINDS.iter().find(|kind| kind.name == asked) else {
            let known: Vec<_> = KINDS.iter().map(|kind| kind.name).collect();
            return Err(source.out_of_range("task.kind", &asked, &known.join(", ")));
        };
        let (common, scene) = (kind.parse)(source)?;
        Ok(common.into_task(name, kind, scene))
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
