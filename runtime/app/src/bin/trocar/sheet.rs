//! The verb `sheet`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use trocar::session::sheet::{self, SheetOptions};
use trocar::session::{SessionError, tasks};
use trocar_render::Shading;

use crate::args::TaskParser;
use crate::commands::Done;
use crate::console;
use crate::scene_args::{Inputs, ScenesArgs};

/// A share of something.
fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("not a number from 0 to 1".to_owned()),
    }
}

/// Options of `sheet`.
#[derive(Args, Debug)]
pub(crate) struct SheetArgs {
    /// The file; parent folders are made.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) out: PathBuf,
    /// A task to show, by name or the path of its folder; may be given several times. All built-in
    /// ones if not given. A needle goes to the tasks that have a choice; a scene file needs one
    /// task.
    #[arg(long, value_parser = TaskParser)]
    pub(crate) task: Vec<String>,
    /// The scene.
    #[command(flatten)]
    pub(crate) scenes: ScenesArgs,
    /// Random seed: the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Width of one image, pixels.
    #[arg(long, value_name = "PX", default_value_t = 192, value_parser = clap::value_parser!(u32).range(16..=1024))]
    pub(crate) width: u32,
    /// The moment, as a share of the time that the expert takes, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.65, value_parser = share)]
    pub(crate) at: f64,
    /// Shading of the images; the scene's if not given. Policies see the scene's.
    #[arg(long, value_enum)]
    pub(crate) shading: Option<ShadingChoice>,
}

/// Kinds of shading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ShadingChoice {
    /// Shadows, mirroring and relief.
    Full,
    /// Tissue for people to look at, edges smoothed.
    Fine,
    /// Painted colours alone.
    Plain,
}

impl From<ShadingChoice> for Shading {
    fn from(choice: ShadingChoice) -> Self {
        match choice {
            ShadingChoice::Full => Self::Full,
            ShadingChoice::Fine => Self::Fine,
            ShadingChoice::Plain => Self::Plain,
        }
    }
}

pub(crate) fn sheet(args: &SheetArgs) -> Done {
    if args.out.extension().is_none_or(|kind| kind != "png") {
        let reason = format!("--out {}: a sheet is FILE.png", args.out.display());
        return Err(SessionError::BadArgument(reason));
    }
    let inputs = Inputs::new([("--scene", args.scenes.scene.scene.as_ref())]);
    let inputs = inputs.and_tasks(&args.task);
    inputs.check(&[("--out", Some(args.out.as_path()))])?;
    let options = SheetOptions {
        tasks: if args.task.is_empty() {
            tasks::names().map(str::to_owned).collect()
        } else {
            args.task.clone()
        },
        scene: args.scenes.options(None),
        out: args.out.clone(),
        seed: args.seed,
        width: args.width,
        at: args.at,
        shading: args.shading.map(Shading::from),
    };
    let bar = console::progress(options.tasks.len() as u64, "tasks");
    sheet::write(&options, &mut |_| bar.inc(1))?;
    bar.finish_and_clear();
    console::result(&format!("wrote {}", args.out.display()));
    Ok(true)
}
