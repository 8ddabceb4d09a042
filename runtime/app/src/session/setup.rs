//! A task with its scene, its limits and the controller's settings, read once and checked once.

use std::path::Path;

use hal::Pose;
use hal::config::Source;
use trocar_nets::compute::Compute;
use trocar_tasks::expert::Expert;
use trocar_tasks::task::{TaskConfig, Variation};

use super::changes::{Changes, ConfigFile};
use super::external::ExternalPolicy;
use super::plan::Arms;
use super::policy_choice::PolicyChoice;
use super::scene_options::SceneOptions;
use super::source::ChunkSource;
use super::steps::PolicySteps;
use super::teleop::{SimulatedOperator, rcms_from_view};
use super::{Robot, SessionError, tasks};
use crate::digest::hash_text;
use trocar_control::{AnyController, ControlConfig};

/// Everything that a session is configured by.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Limits and settings of the arms.
    pub robot: Robot,
    /// Task name.
    pub task_name: String,
    /// The task as it was asked for: a built-in one's name, or the path of its folder.
    pub task_asked: String,
    /// The scene.
    pub task: TaskConfig,
    /// The scene file, if it is not a built-in one.
    pub scene_file: Option<String>,
    /// Whether a second eye was added to the cameras; see [`Self::with_stereo`].
    pub stereo: bool,
    /// Cameras whose frames were asked for; see [`Self::cameras_with`].
    pub kept_cameras: Option<Vec<String>>,
    /// Values in the place of those of the files.
    pub changes: Changes,
}

impl Setup {
    /// The configuration of `task`, a built-in one's name or the path of a folder, with the
    /// controller's settings from `control` if given.
    ///
    /// Without `control`, a checkpoint's own recommendation decides how its chunks are aggregated.
    ///
    /// # Errors
    /// [`SessionError::Config`], [`SessionError::Checkpoint`], or [`SessionError::BadArgument`] for
    /// an unknown task or a policy that is neither a name nor a folder.
    pub fn load(
        task: &str,
        control: Option<&Path>,
        policy: &PolicyChoice,
    ) -> Result<Self, SessionError> {
        Self::read(task, control, policy, None, Changes::default())
    }

    /// The same with the choices of `scene`, and with `changes` over the files that are in effect:
    /// of two scenes the chosen one.
    ///
    /// # Errors
    /// As [`Self::load`] and [`Self::with_scene`].
    pub fn load_with(
        task: &str,
        control: Option<&Path>,
        policy: &PolicyChoice,
        scene: &SceneOptions,
        changes: Changes,
    ) -> Result<Self, SessionError> {
        Self::read(task, control, policy, scene.file.as_deref(), changes)?.with_choices(scene)
    }

    /// Reads all files, with the scene of `scene_file` in the place of the task's own if there is
    /// one.
    fn read(
        task: &str,
        control: Option<&Path>,
        policy: &PolicyChoice,
        scene_file: Option<&Path>,
        changes: Changes,
    ) -> Result<Self, SessionError> {
        let mut files = tasks::files(task)?;
        let name = format!("task {}", files.name);
        let safety = files.safety.clone();
        let mut robot = Robot::read(&name, safety, control, policy, &changes)?;
        let (scene, task_config) = match scene_file {
            None => {
                files.scene = changes.apply(ConfigFile::Scene, files.scene)?;
                (files.scene.clone(), files.config()?)
            }
            Some(path) => other_scene(path, &files.name, files.config()?.kind, &changes)?,
        };
        check_bases(&task_config, &scene, &robot.control)?;
        robot.texts.scene = Some(scene.text().to_owned());
        let scene_file = scene_file.map(Path::to_path_buf);
        let scene_file = scene_file.or_else(|| tasks::paths(task).into_iter().next());
        Ok(Self {
            robot,
            task: task_config,
            task_name: files.name,
            task_asked: task.to_owned(),
            scene_file: scene_file.map(|path| path.display().to_string()),
            stereo: false,
            kept_cameras: None,
            changes,
        })
    }

    /// The same setup with the scene of the file `path`, which must be of the same kind and have
    /// its arms at the same places. The task's name and its safety limits stay.
    ///
    /// # Errors
    /// [`SessionError::Config`], naming file, line and key.
    pub fn with_scene_file(mut self, path: &Path) -> Result<Self, SessionError> {
        let (scene, task) = other_scene(path, &self.task_name, self.task.kind, &self.changes)?;
        check_bases(&task, &scene, &self.robot.control)?;
        self.task = task;
        self.robot.texts.scene = Some(scene.text().to_owned());
        self.scene_file = Some(path.display().to_string());
        Ok(self)
    }

    /// What a person should know before a policy does another task than that of its demonstrations;
    /// none if it does not.
    #[must_use]
    pub fn transfer_note(&self) -> Option<String> {
        let trained_on = self.robot.trained_on.as_ref()?;
        (*trained_on != self.task_name).then(|| {
            format!(
                "the policy was trained on task {trained_on}, not on {}",
                self.task_name
            )
        })
    }

    /// The needle of all episodes, in a task that has a choice; none if each has its own.
    #[must_use]
    pub fn needle(&self) -> Option<&str> {
        let own = self.task.varied.contains(&Variation::Needles);
        self.task.needle().filter(|_| !own)
    }

    /// The beginning of a hash of what the scene is configured by, as a number.
    #[must_use]
    pub fn scene_hash(&self) -> u64 {
        let text = self.robot.texts.scene.as_deref().unwrap_or_default();
        let (needle, view, lie) = (self.needle(), self.task.view, self.task.patient());
        let hash = hash_text(&format!("{needle:?} {view:?} {lie:?} {text}"));
        u64::from_str_radix(hash.get(..16).unwrap_or_default(), 16).unwrap_or_default()
    }

    /// Names of the task's cameras.
    #[must_use]
    pub fn camera_names(&self) -> Vec<String> {
        self.task
            .cameras
            .iter()
            .map(|camera| camera.name.clone())
            .collect()
    }

    /// A fresh controller of all arms of the task.
    ///
    /// # Errors
    /// Those of [`Robot::controller`].
    pub fn controller(&self) -> Result<AnyController, SessionError> {
        self.robot.controller()
    }

    /// The source of chunks that the user asked for; an external policy in lockstep.
    ///
    /// # Errors
    /// Those of [`Robot::network`] and of [`ExternalPolicy::connect`].
    pub fn source(
        &self,
        choice: &PolicyChoice,
        seed: u64,
        compute: impl Into<Compute>,
    ) -> Result<ChunkSource, SessionError> {
        Ok(match choice {
            PolicyChoice::Expert => ChunkSource::Expert {
                expert: Box::new(Expert::new(&self.task, seed)),
                sequence: 0,
            },
            PolicyChoice::Noop => ChunkSource::noop(),
            PolicyChoice::Random => ChunkSource::random(seed),
            PolicyChoice::Teleop => return Err(needs_console()),
            PolicyChoice::Operator(figures) => {
                let operator = SimulatedOperator::new(self, figures, seed);
                ChunkSource::Operator(Box::new(operator))
            }
            PolicyChoice::Checkpoint(path) => {
                ChunkSource::network(self.robot.network(path, compute)?)
            }
            PolicyChoice::External(choice) => {
                let steps = PolicySteps::USUAL;
                ChunkSource::external(ExternalPolicy::connect(choice, self, steps)?)
            }
            PolicyChoice::Own(name) => {
                return Err(SessionError::BadArgument(format!(
                    "policy {name} has to be handed in: run_lockstep_with takes it as ChunkSource::policy, evaluate_with and record_with make one a job"
                )));
            }
        })
    }

    /// Control periods after which an episode is given up; the task's own time limit comes first.
    #[must_use]
    pub fn tick_limit(&self) -> u64 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the limit is checked to lie in 1 to 86400 s"
        )]
        let limit = (self.task.time_limit_s * 1e3) as u64;
        limit + 2000
    }
}

impl Arms for Setup {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn task(&self) -> Option<&Setup> {
        Some(self)
    }

    fn rcms_from_view(&self) -> Vec<Pose> {
        rcms_from_view(&self.task)
    }

    fn source(
        &self,
        choice: &PolicyChoice,
        seed: u64,
        compute: Compute,
    ) -> Result<ChunkSource, SessionError> {
        Self::source(self, choice, seed, compute)
    }
}

/// A person moves in real time, and is seen by the console alone.
fn needs_console() -> SessionError {
    let reason = "policy teleop: an operator's hands move in real time and come over the console: \
                  `trocar run --policy teleop --console`, `trocar record --source teleop --console`";
    SessionError::BadArgument(reason.to_owned())
}

/// The scene of the file `path` for `task`, changed as asked; it must be of the `kind` that the
/// task's own is of.
fn other_scene(
    path: &Path,
    task: &str,
    kind: &str,
    changes: &Changes,
) -> Result<(Source, TaskConfig), SessionError> {
    let source = Source::read(&path.display().to_string())?;
    let scene = changes.apply(ConfigFile::Scene, source)?;
    let config = TaskConfig::parse(task, &scene)?;
    if config.kind != kind {
        let asked = format!("{kind}, as is task {task}");
        return Err(scene.out_of_range("task.kind", config.kind, &asked).into());
    }
    Ok((scene, config))
}

/// The base of arm `index` lies in the `scene`, which came from `source`, where the safety `limits`
/// have it.
fn check_base(
    index: usize,
    limits: Pose,
    scene: Pose,
    source: &Source,
) -> Result<(), SessionError> {
    let off = scene.inverse() * limits;
    let differs = |key: &str, [found, expected]: [[f64; 3]; 2]| {
        let allowed = format!("what safety.toml says, {expected:.6?}");
        source.out_of_range(
            &format!("arm.{index}.{key}"),
            &format!("{found:.6?}"),
            &allowed,
        )
    };
    if off.translation.vector.norm() >= 1e-6 {
        let places = [scene, limits].map(|pose| pose.translation.vector.into());
        return Err(differs("rcm_in_scene_m", places).into());
    }
    if off.rotation.angle() >= 1e-6 {
        let turns = [scene, limits].map(|pose| pose.rotation.euler_angles().into());
        return Err(differs("rcm_in_scene_rpy_rad", turns).into());
    }
    Ok(())
}

/// The scene, which came from `source`, and the safety limits must speak of the same arms at the
/// same places.
fn check_bases(
    task: &TaskConfig,
    source: &Source,
    control: &ControlConfig,
) -> Result<(), SessionError> {
    let counts = (control.arms.len(), task.arms.len());
    if counts.0 != counts.1 {
        let (found, allowed) = (counts.1.to_string(), counts.0.to_string());
        let allowed = format!("the {allowed} of the task's safety.toml");
        return Err(source.out_of_range("arm", &found, &allowed).into());
    }
    for (index, (arm, start)) in control.arms.iter().zip(&task.arms).enumerate() {
        check_base(index, arm.scene_from_rcm, start.scene_from_rcm, source)?;
    }
    Ok(())
}
