//! The verb `import`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use hal::psm;
use trocar::session::run::write_json;
use trocar::session::{SessionError, outputs};
use trocar_data::dataset::SIDE_MAX;
use trocar_data::import::{ImportOptions, Layout, import as import_demonstrations, read_chain};

use crate::args::Video;
use crate::commands::{Done, codec};
use crate::console;

/// Whose program wrote the demonstrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Source {
    /// A folder with episode_0.hdf5 and so on, as ACT and act-plus-plus write it.
    Act,
    /// A file with data/demo_0 and so on.
    Robomimic,
}

/// Options of `import`.
#[derive(Args, Debug)]
pub(crate) struct ImportArgs {
    /// Whose layout the demonstrations have.
    #[arg(value_enum)]
    pub(crate) layout: Source,
    /// The folder with ACT's files, or robomimic's file.
    #[arg(value_name = "FOLDER|FILE")]
    pub(crate) source: PathBuf,
    /// The dataset's directory; a new or an empty one.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Frames a second, which the files do not say.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) fps: u32,
    /// What the demonstrations show, in words.
    #[arg(long)]
    pub(crate) task: String,
    /// Joints and jaw within an episode (7 numbers an arm, of one or two arms: six joint positions in rad, insertion in m, and
    /// the jaw in rad); of act observations/qpos if not given.
    #[arg(long, value_name = "NAME")]
    pub(crate) joints: Option<String>,
    /// Commanded joints and jaw within an episode, alike; of act action if not given.
    #[arg(long, value_name = "NAME", conflicts_with = "action_pose")]
    pub(crate) action_joints: Option<String>,
    /// Commanded tip poses and jaws within an episode instead (8 numbers an arm: position in m, quaternion x, y, z, w in the
    /// arm's RCM frame, jaw in rad).
    #[arg(long, value_name = "NAME")]
    pub(crate) action_pose: Option<String>,
    /// Cameras' frames within an episode, with commas between them: 8-bit RGB, or rows of JPEG. A camera is called what stands
    /// behind the last /, without _image. Of act all in observations/images if not given.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(crate) images: Vec<String>,
    /// JSON with six rows [twist, length, offset along, offset about, slides] (rad, m; modified Denavit-Hartenberg) of another
    /// arm than a patient-side manipulator with a Large Needle Driver.
    #[arg(long, value_name = "FILE")]
    pub(crate) dh: Option<PathBuf>,
    /// Bring frames to this size, such as 512x512, without keeping their proportions. Networks take sizes that are a whole
    /// multiple of their own: train's small preset 256x256, lerobot and paper 512x512.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub(crate) resize: Option<(u32, u32)>,
    /// Keep colour as video instead of as PNG: far smaller, but lossy. Needs
    /// ffmpeg 5.1 or newer, here and where the dataset is read.
    #[arg(long, value_enum, value_name = "CODEC")]
    pub(crate) video: Option<Video>,
    /// Write what was imported as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// `WIDTHxHEIGHT`.
fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        let side = |text: &str| {
            let side = text.parse::<u32>().ok();
            side.filter(|side| (1..=SIDE_MAX).contains(side))
        };
        side(width).zip(side(height))
    });
    sides.ok_or_else(|| format!("a width and a height of 1 to {SIDE_MAX}, such as 512x512"))
}

pub(crate) fn import(args: &ImportArgs) -> Done {
    let source = ("the demonstrations", Some(args.source.as_path()));
    let out = ("--out", Some(args.out.as_path()));
    let dh = ("--dh", args.dh.as_deref());
    if let Some(path) = args.json.as_deref().filter(|path| path.exists()) {
        let folder = path.canonicalize().ok();
        let among = args.source.canonicalize().ok();
        if folder
            .zip(among)
            .is_some_and(|(file, among)| file.starts_with(among))
        {
            let text = format!("--json {}: exists among the demonstrations", path.display());
            return Err(SessionError::BadArgument(text));
        }
    }
    outputs::check(&[("--json", args.json.as_deref())], &[source, out, dh])?;
    outputs::new_folder("--out", &args.out)?;
    let options = ImportOptions {
        layout: match args.layout {
            Source::Act => Layout::Act,
            Source::Robomimic => Layout::Robomimic,
        },
        source: args.source.clone(),
        out: args.out.clone(),
        fps: args.fps,
        task: args.task.clone(),
        joints: args.joints.clone(),
        action_joints: args.action_joints.clone(),
        action_pose: args.action_pose.clone(),
        images: args.images.clone(),
        size: args.resize,
        chain: match &args.dh {
            None => psm::DH,
            Some(path) => read_chain(path).map_err(SessionError::from)?,
        },
        video: args.video.map(codec),
    };
    let bar = console::progress(0, "episodes");
    let summary = import_demonstrations(&options, &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let summary = summary?;
    console::result(&format!(
        "{} episodes, {} frames in {}",
        summary.episodes,
        summary.frames,
        args.out.display()
    ));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}
