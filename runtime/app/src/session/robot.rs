//! A robot as a session sees it: limits and settings, and neither task nor scene nor verdict.

use std::path::Path;

use hal::config::Source;
use trocar_nets::checkpoint::load_recipe;
use trocar_nets::compute::Compute;
use trocar_nets::loaded_policy::LoadedPolicy;

use super::SessionError;
use super::changes::{Changes, ConfigFile};
use super::run::{RunOptions, versions};
use super::setup::{Texts, built_in_control, network};
use super::source::{ChunkSource, PolicyChoice};
use trocar_control::{AnyController, ControlConfig};
use trocar_log::RunHeader;

/// Everything that a run without a task is configured by.
#[derive(Clone, Debug)]
pub struct Robot {
    /// The controller.
    pub control: ControlConfig,
    /// The texts it came from, for the log.
    pub texts: Texts,
    /// Where the limits were read.
    pub safety_file: String,
    /// The task of the demonstrations that the policy was trained on, if it is a checkpoint that tells.
    pub trained_on: Option<String>,
    /// SHA-256 of the policy's weights, if it is a checkpoint.
    pub weights_sha256: Option<String>,
}

impl Robot {
    /// Reads limits from the file `safety` (the form of a task's `safety.toml`) and the controller's settings from `control`, or
    /// takes the built-in ones, with `changes` over both.
    ///
    /// # Errors
    /// [`SessionError::Config`], [`SessionError::Checkpoint`], or [`SessionError::BadArgument`] for a policy that is neither a name
    /// nor a folder, and for the expert, which needs a scene.
    pub fn load(
        safety: &Path,
        control: Option<&Path>,
        policy: &PolicyChoice,
        changes: &Changes,
    ) -> Result<Self, SessionError> {
        policy.check_exists()?;
        let recipe = match policy {
            PolicyChoice::Checkpoint(folder) => load_recipe(folder)?,
            PolicyChoice::Noop
            | PolicyChoice::Random
            | PolicyChoice::Own(_)
            | PolicyChoice::External(_) => None,
            PolicyChoice::Expert => {
                let reason = "--policy expert: it sees the simulator's scene and needs a --task";
                return Err(SessionError::BadArgument(reason.to_owned()));
            }
        };
        let control = match control {
            Some(path) => Source::read(&path.display().to_string())?,
            None => built_in_control(recipe.as_ref())?,
        };
        let control = changes.apply(ConfigFile::Control, control)?;
        let safety_file = safety.display().to_string();
        let safety = changes.apply(ConfigFile::Safety, Source::read(&safety_file)?)?;
        Ok(Self {
            control: ControlConfig::load(&control, &safety)?,
            texts: Texts {
                control: control.text().to_owned(),
                safety: safety.text().to_owned(),
                scene: None,
                can: None,
            },
            safety_file,
            trained_on: recipe.map(|recipe| recipe.dataset.task),
            weights_sha256: policy.weights_sha256()?,
        })
    }

    /// How many arms it has.
    #[must_use]
    pub fn arms(&self) -> usize {
        self.control.arms.len()
    }

    /// A fresh controller of all its arms.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if the configuration can't be turned into one.
    pub fn controller(&self) -> Result<AnyController, SessionError> {
        AnyController::new(&self.control)
            .map_err(|error| SessionError::BadArgument(error.to_string()))
    }

    /// The network in `folder`.
    ///
    /// # Errors
    /// [`SessionError::Checkpoint`], or [`SessionError::BadArgument`] if it is for another number of arms.
    pub fn network(
        &self,
        folder: &Path,
        compute: impl Into<Compute>,
    ) -> Result<LoadedPolicy, SessionError> {
        network(folder, compute, self.arms(), &self.safety_file)
    }

    /// What answers in this process: a policy that sees nothing but the arms.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] for any other: the expert needs a scene, a checkpoint has a process of its own, and one's own policy
    /// is handed to a run in lockstep.
    pub fn source(choice: &PolicyChoice, seed: u64) -> Result<ChunkSource, SessionError> {
        match choice {
            PolicyChoice::Noop => Ok(ChunkSource::noop()),
            PolicyChoice::Random => Ok(ChunkSource::random(seed)),
            PolicyChoice::Expert
            | PolicyChoice::Checkpoint(_)
            | PolicyChoice::Own(_)
            | PolicyChoice::External(_) => {
                let name = choice.name();
                Err(SessionError::BadArgument(format!(
                    "policy {name}: without a task the policies of this process are noop and random"
                )))
            }
        }
    }

    /// How a log of it begins.
    #[must_use]
    pub fn header(&self, options: &RunOptions) -> RunHeader {
        RunHeader {
            policy: options.policy.name(),
            seed: options.seed,
            versions: versions(&options.policy, self.weights_sha256.as_deref()),
            texts: self.texts.by_name(),
            ..RunHeader::default()
        }
    }
}
