//! `trocar config`, `completions` and `man`: what the program can say of itself.

use std::fs;
use std::path::PathBuf;

use clap::{Args, CommandFactory as _, Subcommand, ValueEnum};
use trocar_canopen::master::CanConfig;

use trocar::rt::RtProfile;
use trocar::session::changes::{Change, Changes, ConfigFile};
use trocar::session::scene_options::SceneOptions;
use trocar::session::{PolicyChoice, SessionError, Setup};

use crate::args::{Cli, TaskParser};
use crate::commands::{Done, realtime_source};
use crate::console;
use crate::drives::can_source;

/// What to do with the configuration.
#[derive(Debug, Subcommand)]
pub(crate) enum ConfigVerb {
    /// Print a file as a run would read it: built in or given, with the policy's recommendation and
    /// every --set.
    #[command(
        after_help = "Example: trocar config show control\n         trocar config show scene --task suture-pad\n         trocar config show can --set can.cycle_us=4000 > can.toml"
    )]
    Show(ShowArgs),
}

/// Options of `config show`.
#[derive(Args, Debug)]
pub(crate) struct ShowArgs {
    /// The file.
    #[arg(value_enum)]
    pub(crate) file: ShownFile,
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser, default_value = "needle-lift")]
    pub(crate) task: String,
    /// The policy, of which a checkpoint may recommend how its chunks are aggregated.
    #[arg(long, default_value = "expert")]
    pub(crate) policy: String,
    /// Controller configuration instead of the built-in one.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Nodes and interfaces instead of the built-in ones.
    #[arg(long, value_name = "FILE")]
    pub(crate) can_config: Option<PathBuf>,
    /// What the control thread asks of the operating system, instead of the built-in file.
    #[arg(long, value_name = "FILE")]
    pub(crate) realtime: Option<PathBuf>,
    /// Override one configuration value. May be given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    pub(crate) set: Vec<Change>,
}

/// A configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ShownFile {
    /// The controller's settings.
    Control,
    /// The task's limits.
    Safety,
    /// The task's scene.
    Scene,
    /// Nodes and buses.
    Can,
    /// What the threads of a run in real time ask of the operating system.
    Realtime,
}

/// Options of `completions`.
#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub(crate) shell: clap_complete::Shell,
}

/// Options of `man`.
#[derive(Args, Debug)]
pub(crate) struct ManArgs {
    /// The folder, which is made.
    pub(crate) out: PathBuf,
}

pub(crate) fn config(verb: &ConfigVerb) -> Done {
    match verb {
        ConfigVerb::Show(args) => show(args),
    }
}

fn show(args: &ShowArgs) -> Done {
    let changes = Changes(args.set.clone());
    let text = match args.file {
        ShownFile::Can => {
            changes.only(&[ConfigFile::Can])?;
            let source = changes.apply(ConfigFile::Can, can_source(args.can_config.as_ref())?)?;
            CanConfig::load(&source)?;
            source.text().to_owned()
        }
        ShownFile::Realtime => {
            changes.only(&[ConfigFile::Realtime])?;
            let source = realtime_source(args.realtime.as_deref(), &changes)?;
            RtProfile::load(&source)?;
            source.text().to_owned()
        }
        ShownFile::Control | ShownFile::Safety | ShownFile::Scene => of_a_task(args, changes)?,
    };
    console::text(&text);
    Ok(true)
}

/// The text of one of a task's files.
fn of_a_task(args: &ShowArgs, changes: Changes) -> Result<String, SessionError> {
    changes.only(&[ConfigFile::Control, ConfigFile::Safety, ConfigFile::Scene])?;
    let policy = PolicyChoice::parse(&args.policy);
    let (config, scene) = (args.config.as_deref(), SceneOptions::default());
    let setup = Setup::load_with(&args.task, config, &policy, &scene, changes)?;
    let texts = setup.robot.texts;
    Ok(match args.file {
        ShownFile::Control => texts.control,
        ShownFile::Safety => texts.safety,
        ShownFile::Scene | ShownFile::Can | ShownFile::Realtime => texts.scene.unwrap_or_default(),
    })
}

pub(crate) fn completions(args: &CompletionsArgs) -> Done {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "trocar", &mut text);
    console::text(&String::from_utf8_lossy(&text));
    Ok(true)
}

pub(crate) fn man(args: &ManArgs) -> Done {
    let out = &args.out;
    let written =
        fs::create_dir_all(out).and_then(|()| clap_mangen::generate_to(Cli::command(), out));
    written.map_err(|error| {
        SessionError::BadArgument(format!("{}: cannot be written: {error}", out.display()))
    })?;
    Ok(true)
}
