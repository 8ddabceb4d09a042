//! `trocar config`, `completions` and `man`: what the program can say of itself.

use std::fs;

use clap::CommandFactory as _;
use trocar_canopen::master::CanConfig;

use trocar::rt::RtProfile;
use trocar::session::changes::{Changes, ConfigFile};
use trocar::session::scene_options::SceneOptions;
use trocar::session::{PolicyChoice, SessionError, Setup};

use crate::args::{Cli, CompletionsArgs, ConfigVerb, ManArgs, ShowArgs, ShownFile};
use crate::commands::{Done, realtime_source};
use crate::console;
use crate::drives::can_source;

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
