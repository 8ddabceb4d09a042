//! `trocar config`, `completions` and `man`: what the program can say of itself.

use std::fs;

use clap::CommandFactory as _;
use trocar_canopen::master::CanConfig;

use trocar::session::changes::{Changes, ConfigFile};
use trocar::session::scene_options::SceneOptions;
use trocar::session::{PolicyChoice, SessionError, Setup};

use crate::args::{Cli, CompletionsArgs, ConfigVerb, ManArgs, ShowArgs, ShownFile};
use crate::commands::Done;
use crate::console;
use crate::drives::can_source;

pub(crate) fn config(verb: &ConfigVerb) -> Done {
    match verb {
        ConfigVerb::Show(args) => show(args),
    }
}

fn show(args: &ShowArgs) -> Done {
    let changes = Changes(args.set.clone());
    if args.file == ShownFile::Can {
        changes.only(&[ConfigFile::Can])?;
        let source = changes.apply(ConfigFile::Can, can_source(args.can_config.as_ref())?)?;
        CanConfig::load(&source)?;
        console::text(source.text());
        return Ok(true);
    }
    changes.only(&[ConfigFile::Control, ConfigFile::Safety, ConfigFile::Scene])?;
    let policy = PolicyChoice::parse(&args.policy);
    let (config, scene) = (args.config.as_deref(), SceneOptions::default());
    let setup = Setup::load_with(&args.task, config, &policy, &scene, changes)?;
    console::text(match args.file {
        ShownFile::Control => &setup.robot.texts.control,
        ShownFile::Safety => &setup.robot.texts.safety,
        ShownFile::Scene | ShownFile::Can => setup.robot.texts.scene.as_deref().unwrap_or_default(),
    });
    Ok(true)
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
