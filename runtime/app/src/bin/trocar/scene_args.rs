//! The options that choose a scene among those that a task has.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use trocar::session::changes::Change;
use trocar::session::scene_options::{CameraSet, SceneOptions};
use trocar::session::{PolicyChoice, SessionError, Setup, outputs, tasks};
use trocar_tasks::task::{Variation, View};

use crate::commands::task_changes;

/// From where the cameras look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ViewChoice {
    /// As in the scene file, where demonstrations are recorded.
    Train,
    /// Endoscope and side camera shifted along each of their axes by up to 1 cm and turned about
    /// each by up to 5 degrees, uniformly, by the episode's seed.
    View1,
    /// Endoscope and side camera swapped.
    View2,
}

impl From<ViewChoice> for View {
    fn from(choice: ViewChoice) -> Self {
        match choice {
            ViewChoice::Train => Self::Train,
            ViewChoice::View1 => Self::View1,
            ViewChoice::View2 => Self::View2,
        }
    }
}

/// Which scene it is, of those that a task has.
#[derive(Args, Debug)]
pub(crate) struct SceneArgs {
    /// The task's scene instead of the scene.toml in its folder: a changed copy of that file. The
    /// arms stay where they are; the task's name and safety limits do not change with it.
    #[arg(long, value_name = "FILE")]
    pub(crate) scene: Option<PathBuf>,
    /// The needle, N1 to N5 in needle-lift; N1, which demonstrations are recorded with, if not
    /// given.
    #[arg(long, value_name = "NAME")]
    pub(crate) needle: Option<String>,
    /// From where the cameras look; wrist cameras stay as they are.
    #[arg(long, value_enum, default_value = "train")]
    pub(crate) view: ViewChoice,
}

/// Domain randomisation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum VaryChoice {
    /// The needle: one of N1 to N5, each as likely. Of needle-lift only.
    Needles,
    /// Where endoscope and side camera stand: as with --view view1.
    Views,
    /// The light guide's place (2 cm along the lens' axes) and direction (7 degrees), its
    /// brightness and that of the light from all around (0.63 to 1.6 times), the colour of the
    /// light (about 5100 K to 9000 K), and colours of things (0.8 to 1.25 times, and 10 % a
    /// channel).
    Light,
    /// Each camera's lens and sensor: distortion (the corner's rays 12 % inwards to 2 % outwards),
    /// vignette (up to half of the corner's light), exposure (0.71 to 1.4 times), noise, and in
    /// three of ten episodes each smoke, blood and condensate. Not with --depth, whose lens is one
    /// for the dataset.
    Lens,
    /// Of lens the distortion alone, as it draws it; so are the following. Not with --depth.
    Distortion,
    /// The light that the corners lose.
    Vignette,
    /// The light that the sensor collects.
    Exposure,
    /// The sensor's noise.
    Noise,
    /// Smoke.
    Smoke,
    /// Blood on the lens.
    Blood,
    /// Condensate on the lens.
    Fog,
}

impl From<VaryChoice> for Variation {
    fn from(choice: VaryChoice) -> Self {
        match choice {
            VaryChoice::Needles => Self::Needles,
            VaryChoice::Views => Self::Views,
            VaryChoice::Light => Self::Light,
            VaryChoice::Lens => Self::Lens,
            VaryChoice::Distortion => Self::Distortion,
            VaryChoice::Vignette => Self::Vignette,
            VaryChoice::Exposure => Self::Exposure,
            VaryChoice::Noise => Self::Noise,
            VaryChoice::Smoke => Self::Smoke,
            VaryChoice::Blood => Self::Blood,
            VaryChoice::Fog => Self::Fog,
        }
    }
}

/// The scenes of many episodes.
#[derive(Args, Debug)]
pub(crate) struct ScenesArgs {
    /// What all have in common.
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Domain randomisation for each episode, from its seed, beyond where things lie; several with
    /// commas between them.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT,...")]
    vary: Vec<VaryChoice>,
}

impl ScenesArgs {
    /// The choices, with `cameras` for those whose frames are kept.
    pub(crate) fn options(&self, cameras: Option<&str>) -> SceneOptions {
        SceneOptions {
            varied: self.vary.iter().map(|&choice| choice.into()).collect(),
            ..self.scene.options(cameras)
        }
    }
}

/// The controller's configuration, and single values of a task's files.
#[derive(Args, Debug)]
pub(crate) struct ConfigArgs {
    /// Controller configuration instead of the built-in config/control.toml.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Override one configuration value: FILE.KEY=VALUE, where FILE is control, safety or scene.
    /// May be given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    set: Vec<Change>,
}

impl ConfigArgs {
    /// The configuration of `task` for `policy` in the scene that `options` choose.
    pub(crate) fn setup(
        &self,
        task: &str,
        policy: &PolicyChoice,
        options: &SceneOptions,
    ) -> Result<Setup, SessionError> {
        let changes = task_changes(&self.set)?;
        Setup::load_with(task, self.config.as_deref(), policy, options, changes)
    }
}

/// What a verb reads, which results must not take the place of.
#[derive(Default)]
pub(crate) struct Inputs {
    files: Vec<(&'static str, Option<PathBuf>)>,
}

impl Inputs {
    /// These files, by the options that name them.
    pub(crate) fn new<const N: usize>(files: [(&'static str, Option<&PathBuf>); N]) -> Self {
        let files = files.map(|(option, path)| (option, path.cloned()));
        Self {
            files: files.into(),
        }
    }

    /// And these, which `option` names.
    pub(crate) fn and_each(mut self, option: &'static str, files: &[PathBuf]) -> Self {
        let files = files.iter().cloned();
        self.files.extend(files.map(|file| (option, Some(file))));
        self
    }

    /// And those of `named`, tasks that may be built-in ones.
    pub(crate) fn and_tasks<'a>(mut self, named: impl IntoIterator<Item = &'a String>) -> Self {
        let files = named.into_iter().flat_map(|task| tasks::paths(task));
        self.files.extend(files.map(|file| ("--task", Some(file))));
        self
    }

    /// And those of the policy `text`, if it is a checkpoint.
    pub(crate) fn and_policy(mut self, text: &str) -> Self {
        if let PolicyChoice::Checkpoint(folder) = PolicyChoice::parse(text) {
            let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
            self.files
                .extend(files.map(|file| ("--policy", Some(file.path()))));
        }
        self
    }

    /// Checks that `results` can be written and are none of these.
    pub(crate) fn check(&self, results: &[(&str, Option<&Path>)]) -> Result<(), SessionError> {
        let files = self.files.iter();
        let files: Vec<_> = files
            .map(|(option, path)| (*option, path.as_deref()))
            .collect();
        outputs::check(results, &files)
    }
}

impl SceneArgs {
    /// The choices, with `cameras` for those whose frames are kept.
    pub(crate) fn options(&self, cameras: Option<&str>) -> SceneOptions {
        SceneOptions {
            file: self.scene.clone(),
            needle: self.needle.clone(),
            view: self.view.into(),
            varied: Vec::new(),
            cameras: cameras.map(CameraSet::parse),
        }
    }
}
