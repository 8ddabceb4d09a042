//! A robot as a session sees it: limits and settings, and neither task nor scene nor verdict.

use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

use hal::config::Source;
use hal::{ARM_NAMES, ArmState, Pose};
use nalgebra::{Translation3, UnitQuaternion};
use trocar_nets::checkpoint::{Recipe, load_recipe};
use trocar_nets::compute::Compute;
use trocar_nets::loaded_policy::{LoadedPolicy, PolicyOutline};

use super::changes::{Changes, ConfigFile};
use super::plan::Arms;
use super::policy_choice::PolicyChoice;
use super::run::LIBTORCH_VERSION;
use super::source::ChunkSource;
use super::{SessionError, Setup};
use crate::rt;
use trocar_control::{AnyController, ControlConfig, MeasuredClearance, beyond};

/// What arms are configured by, with a task or without.
#[derive(Clone, Debug)]
pub struct Robot {
    /// The controller.
    pub control: ControlConfig,
    /// The texts it came from, for the log.
    pub texts: Texts,
    /// Whose arms they are: a task's by name, or else the file that the limits were read from.
    pub name: String,
    /// The axes in which an operator's hands move (x to the right, y up, z towards the viewer), as
    /// each arm's RCM frame has them; none if no hands are to move the arms.
    pub rcms_from_view: Vec<Pose>,
    /// The task of the demonstrations that the policy was trained on, if it is a checkpoint that
    /// tells.
    pub trained_on: Option<String>,
    /// SHA-256 of the policy's weights, if it is a checkpoint: what results and logs know them by.
    pub weights_sha256: Option<String>,
}

/// The axes in which an operator's hands move an arm, `ARM=X,Y,Z`: how those of the view (x to the
/// right, y up, z towards the viewer) are turned in the arm's RCM frame, degrees about its x, then
/// its y, then its z.
#[derive(Clone, Debug, PartialEq)]
pub struct HandsView {
    arm: String,
    rcm_from_view: Pose,
}

impl FromStr for HandsView {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = "it has the form ARM=X,Y,Z, such as psm1=25,0,0, each in [-360, 360] degrees";
        let (arm, angles) = text.split_once('=').ok_or(form)?;
        let angles: Vec<f64> = angles
            .split(',')
            .map(|angle| angle.trim().parse().map_err(|_| form))
            .collect::<Result<_, _>>()?;
        let within = angles.iter().all(|angle| (-360.0..=360.0).contains(angle));
        let &[roll, pitch, yaw] = angles.as_slice() else {
            return Err(form.to_owned());
        };
        if !within {
            return Err(form.to_owned());
        }
        let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        Ok(Self {
            arm: arm.trim().to_owned(),
            rcm_from_view: Pose::from_parts(Translation3::identity(), rotation),
        })
    }
}

fn bad_view(reason: &str) -> SessionError {
    SessionError::BadArgument(format!("--hands-view ARM=X,Y,Z: {reason}"))
}

/// Effective configuration texts.
#[derive(Clone, Debug)]
pub struct Texts {
    /// The controller's settings.
    pub control: String,
    /// The limits.
    pub safety: String,
    /// The task's scene, if there is a task.
    pub scene: Option<String>,
    /// Nodes and buses, if the arms are on CAN.
    pub can: Option<String>,
}

impl Texts {
    /// Them by the names of their files, as a log has them.
    #[must_use]
    pub fn by_name(&self) -> BTreeMap<String, String> {
        let texts = [
            ("control.toml", Some(&self.control)),
            ("safety.toml", Some(&self.safety)),
            ("scene.toml", self.scene.as_ref()),
            ("can.toml", self.can.as_ref()),
        ];
        texts
            .into_iter()
            .filter_map(|(name, text)| Some((name.to_owned(), text?.clone())))
            .collect()
    }
}

impl Robot {
    /// Reads limits from the file `safety` (the form of a task's `safety.toml`) and the
    /// controller's settings from `control`, or takes the built-in ones, with `changes` over both.
    ///
    /// # Errors
    /// [`SessionError::Config`], [`SessionError::Checkpoint`], or [`SessionError::BadArgument`] for
    /// a policy that is neither a name nor a folder, and for the expert, which needs a scene.
    pub fn load(
        safety: &Path,
        control: Option<&Path>,
        policy: &PolicyChoice,
        changes: &Changes,
    ) -> Result<Self, SessionError> {
        if *policy == PolicyChoice::Expert {
            let reason = "--policy expert: it sees the simulator's scene and needs a --task";
            return Err(SessionError::BadArgument(reason.to_owned()));
        }
        let name = safety.display().to_string();
        Self::read(&name, Source::read(&name)?, control, policy, changes)
    }

    /// The same with the limits of `safety`, of the arms of `name`.
    pub(super) fn read(
        name: &str,
        safety: Source,
        control: Option<&Path>,
        policy: &PolicyChoice,
        changes: &Changes,
    ) -> Result<Self, SessionError> {
        policy.check_exists()?;
        let recipe = policy.recipe()?;
        let control = match control {
            Some(path) => Source::read(&path.display().to_string())?,
            None if matches!(policy, PolicyChoice::Teleop | PolicyChoice::Operator(_)) => {
                newest_alone()?
            }
            None => built_in_control(recipe.as_ref())?,
        };
        let control = changes.apply(ConfigFile::Control, control)?;
        let safety = changes.apply(ConfigFile::Safety, safety)?;
        Ok(Self {
            control: ControlConfig::load(&control, &safety)?,
            texts: Texts {
                control: control.text().to_owned(),
                safety: safety.text().to_owned(),
                scene: None,
                can: None,
            },
            name: name.to_owned(),
            rcms_from_view: Vec::new(),
            trained_on: recipe.map(|recipe| recipe.dataset.task),
            weights_sha256: policy.weights_sha256()?,
        })
    }

    /// The same, whose arms an operator's hands may move in the axes of `views`, one an arm.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if an arm has none, or another or the same one twice is named.
    pub fn moved_in(self, views: &[HandsView]) -> Result<Self, SessionError> {
        let arms = self.arms();
        let mut rcms_from_view = Vec::new();
        for name in ARM_NAMES.iter().take(arms) {
            let mut of_arm = views.iter().filter(|view| view.arm == *name);
            match (of_arm.next(), of_arm.next()) {
                (Some(view), None) => rcms_from_view.push(view.rcm_from_view),
                (None, _) => return Err(bad_view(&format!("{name} has none"))),
                (Some(_), Some(_)) => return Err(bad_view(&format!("{name} has two"))),
            }
        }
        let stranger = views
            .iter()
            .find(|view| !ARM_NAMES.iter().take(arms).any(|name| view.arm == *name));
        if let Some(HandsView { arm, .. }) = stranger {
            let reason = format!("there is no arm {arm}, {} has {arms}", self.name);
            return Err(bad_view(&reason));
        }
        Ok(Self {
            rcms_from_view,
            ..self
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

    /// The network in `folder`, computing as `compute` says.
    ///
    /// # Errors
    /// [`SessionError::Checkpoint`], or [`SessionError::BadArgument`] if it is for another number
    /// of arms.
    pub fn network(
        &self,
        folder: &Path,
        compute: impl Into<Compute>,
    ) -> Result<LoadedPolicy, SessionError> {
        // Before the weights: they would only take time.
        self.check_arms(folder, load_recipe(folder)?.map(|recipe| recipe.arms))?;
        Ok(LoadedPolicy::load(folder, compute)?)
    }

    /// What is known of the policy in `folder` before its weights are read; it must be for as many
    /// arms.
    pub(super) fn outline(&self, folder: &Path) -> Result<PolicyOutline, SessionError> {
        let outline = PolicyOutline::read(folder)?;
        self.check_arms(folder, Some(outline.recipe.arms))?;
        Ok(outline)
    }

    fn check_arms(&self, folder: &Path, commanded: Option<usize>) -> Result<(), SessionError> {
        if let Some(commanded) = commanded.filter(|commanded| *commanded != self.arms()) {
            return Err(SessionError::BadArgument(format!(
                "policy {}: trocar.json: arms = {commanded}, {} has {}",
                folder.display(),
                self.name,
                self.arms()
            )));
        }
        Ok(())
    }

    /// What is running and where: program with its commit, library, a checkpoint's weights by their
    /// SHA-256 and the dataset that it was trained on, and the machine.
    pub(super) fn versions(&self, policy: &PolicyChoice) -> BTreeMap<String, String> {
        let dataset = policy.recipe().ok().flatten().map(|recipe| {
            let dataset = recipe.dataset;
            format!(
                "{}, {} episodes, {} frames at {} Hz",
                dataset.task, dataset.episodes, dataset.frames, dataset.fps
            )
        });
        let machine = rt::machine();
        let versions = [
            ("trocar", Some(env!("CARGO_PKG_VERSION"))),
            ("commit", Some(env!("TROCAR_COMMIT"))),
            ("libtorch", Some(LIBTORCH_VERSION)),
            ("weights_sha256", self.weights_sha256.as_deref()),
            ("dataset", dataset.as_deref()),
            ("machine", Some(machine.as_str())),
        ];
        versions
            .into_iter()
            .filter_map(|(name, version)| Some((name.to_owned(), version?.to_owned())))
            .collect()
    }
}

impl Arms for Robot {
    fn robot(&self) -> &Robot {
        self
    }

    fn task(&self) -> Option<&Setup> {
        None
    }

    fn rcms_from_view(&self) -> Vec<Pose> {
        self.rcms_from_view.clone()
    }

    /// A policy that sees nothing but the arms: the expert needs a scene, a checkpoint has a
    /// process of its own, and one's own policy is handed to a run.
    fn source(
        &self,
        choice: &PolicyChoice,
        seed: u64,
        _compute: Compute,
    ) -> Result<ChunkSource, SessionError> {
        match choice {
            PolicyChoice::Noop => Ok(ChunkSource::noop()),
            PolicyChoice::Random => Ok(ChunkSource::random(seed)),
            PolicyChoice::Teleop => Err(SessionError::BadArgument(
                "policy teleop: of a robot without a task it needs --hands-view ARM=X,Y,Z, the axes in which hands move each arm".to_owned(),
            )),
            PolicyChoice::Expert
            | PolicyChoice::Operator(_)
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
}

/// The built-in settings, with the aggregation that the checkpoint recommends.
fn built_in_control(recipe: Option<&Recipe>) -> Result<Source, SessionError> {
    match recipe.map(|recipe| &recipe.aggregation) {
        Some(recommended) => aggregated(recommended.mode.as_str(), Some(recommended.decay)),
        None => Ok(ControlConfig::default_control()),
    }
}

/// The built-in settings for a hand: where it was before is of no interest.
fn newest_alone() -> Result<Source, SessionError> {
    aggregated("newest", None)
}

fn aggregated(mode: &str, decay: Option<f64>) -> Result<Source, SessionError> {
    let mut control: toml::Table = ControlConfig::default_control().parse()?;
    if let Some(aggregation) = control
        .get_mut("aggregation")
        .and_then(toml::Value::as_table_mut)
    {
        aggregation.insert("mode".to_owned(), mode.into());
        if let Some(decay) = decay {
            aggregation.insert("decay".to_owned(), decay.into());
        }
    }
    Ok(Source::embedded(
        "config/control.toml with the policy's aggregation",
        &control.to_string(),
    ))
}

/// Says where arms are beyond a boundary before they are enabled there.
pub(super) fn warn_of_start(control: &ControlConfig, arms: &[ArmState], warn: fn(&str)) {
    for start in beyond(control, arms) {
        let MeasuredClearance {
            arm,
            boundary,
            part,
            clearance_m,
            ..
        } = start;
        warn(&format!(
            "{arm} is enabled {:.2} mm beyond {boundary} ({part}): the boundary closes in behind it as it comes out",
            -1e3 * clearance_m
        ));
    }
}
