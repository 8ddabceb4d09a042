//! The verb `cameras`: a task's cameras in a process of their own.

use clap::Args;

use trocar::rt;
use trocar::session::changes::Change;
use trocar::session::realtime::{CamerasOptions, serve_cameras};
use trocar::session::scene_options::CameraSet;
use trocar::session::{PolicyChoice, SessionError, Setup};

use crate::args::TaskParser;
use crate::commands::{Done, task_changes};
use crate::console;
use crate::scene_args::ScenesArgs;

/// The topics' name unless another one is asked for.
const DEFAULT_TOPICS: &str = "cameras";

/// Options of `cameras`.
#[derive(Args, Debug)]
pub(crate) struct CamerasArgs {
    /// The task whose cameras these are: a built-in one by name, or the path of a folder. The run's
    /// must be the same.
    #[arg(long, value_parser = TaskParser, default_value = "needle-lift")]
    pub(crate) task: String,
    /// Names the topics of the run, on which the frames are shown too.
    #[arg(long, value_name = "NAME", default_value = DEFAULT_TOPICS)]
    pub(crate) topics: String,
    /// Cameras whose frames are shown: `single`, `multi`, or names with commas between them; the
    /// task's first if not given.
    #[arg(long, value_name = "single|multi|NAMES")]
    pub(crate) cameras: Option<String>,
    /// The scene, as the run has it.
    #[command(flatten)]
    pub(crate) scenes: ScenesArgs,
    /// Override one configuration value, as the run does: FILE.KEY=VALUE, where FILE is safety or
    /// scene. May be given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    pub(crate) set: Vec<Change>,
    /// Random seed of the scene before a run says another.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Show the run's console what its pages look at too.
    #[arg(long, hide = true)]
    pub(crate) pages: bool,
    /// A right eye beside the endoscope.
    #[arg(long, hide = true)]
    pub(crate) stereo: bool,
    /// The run that started this process; it goes when that one is gone.
    #[arg(long, hide = true)]
    pub(crate) parent_pid: Option<u32>,
}

pub(crate) fn cameras(args: &CamerasArgs) -> Done {
    let (changes, scene) = (task_changes(&args.set)?, args.scenes.options(None));
    let mut setup = Setup::load_with(&args.task, None, &PolicyChoice::Noop, &scene, changes)?;
    if args.stereo {
        setup = setup.with_stereo()?;
    }
    if let Some(cameras) = &args.cameras {
        setup = setup.keeping(&CameraSet::parse(cameras))?;
    }
    let cameras = if args.pages && args.cameras.is_none() {
        Vec::new()
    } else {
        setup.cameras_with(Vec::new())
    };
    let by_hand = args.parent_pid.is_none();
    if by_hand {
        rt::catch_interrupts().map_err(SessionError::signals)?;
    }
    let options = CamerasOptions {
        topics: args.topics.clone(),
        setup,
        seed: args.seed,
        cameras,
        pages: args.pages,
        parent: args.parent_pid,
    };
    let drawn = serve_cameras(&options, &mut |said| {
        console::note(&format!("trocar: {said}"));
    })?;
    if by_hand {
        console::note(&format!("trocar: {drawn} instants drawn"));
    }
    Ok(true)
}
