//! The verb `import`.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use hal::config::ConfigError;
use hal::psm;
use trocar::session::run::write_json;
use trocar::session::{SessionError, outputs};
use trocar_data::dataset::SIDE_MAX;
use trocar_data::import::{
    ImportOptions, ImportRequest, Layout, Mapping, import as import_demonstrations, import_mapped,
    read_chain,
};

use crate::args::Video;
use crate::commands::{Done, codec};
use crate::console;
use crate::import_log::{ImportLogArgs, import_log};

/// Whose demonstrations they are.
#[derive(Debug, Subcommand)]
pub(crate) enum ImportVerb {
    /// A folder with episode_0.hdf5 and so on, as ACT and act-plus-plus write it.
    #[command(
        after_help = "Example: trocar import act FOLDER --fps 25 --task \"Lift the needle\" --out runs/demos"
    )]
    Act(ImportArgs),
    /// A file with data/demo_0 and so on.
    #[command(
        after_help = "Example: trocar import robomimic FILE.hdf5 --fps 25 --task \"Lift the needle\" --out runs/demos --joints obs/joint_pos --images obs/endoscope_image --action-pose actions"
    )]
    Robomimic(ImportArgs),
    /// A LeRobot dataset of v2.0, v2.1 or v3.0, or a dVRK's raw recordings, by a table of names.
    #[command(
        after_help = "Example: trocar import lerobot FOLDER --mapping open-h-dvrk --out runs/demos\n         trocar import lerobot FOLDER --mapping my.toml --task \"Throw a suture\" --split perfect --resize 512x512 --out runs/demos\n         trocar import lerobot FOLDER --mapping dvrk-raw --out runs/demos\n\nA mapping is TOML: which numbers are each arm's pose or joints, jaw and action, in which units, and which feature is which camera; config/mappings/ has those that are built in, to copy from. Joints that are not there are computed from the poses; a pose out of the arm's reach is refused with episode and step. Episodes of the split failure are left out unless asked for."
    )]
    Lerobot(LerobotArgs),
    /// Logs of runs (`trocar run --log`), of a robot or simulated, each an episode.
    #[command(
        after_help = "Example: trocar import log runs/a.mcap runs/b.mcap --task \"Lift the needle\" --out runs/demos\n         trocar run --backend topics --safety limits.toml --policy runs/act --topics cameras --cameras endoscope --log runs/a.mcap\n         trocar import log runs/*.mcap --task \"Lift the needle\" --fps 25 --resize 512x512 --out runs/robot\n         trocar train --policy act --data runs/demos --data runs/robot --out runs/better\n\nA step is a frame of the first camera, on a grid of --fps; of the other cameras the nearest frame; the arms as they were measured at the nearest tick; as action the target of the chunks at that tick. An episode begins with the first target of enabled arms, and ends as the run's end lets them rest. Where an operator took over from a policy, each frame says who drove. Logs that are cut off, holes between frames and non-finite numbers are refused before anything is written."
    )]
    Log(ImportLogArgs),
}

impl ImportVerb {
    /// Where the result goes as JSON.
    pub(crate) const fn json(&self) -> &Option<PathBuf> {
        match self {
            Self::Act(args) | Self::Robomimic(args) => &args.json,
            Self::Lerobot(args) => &args.json,
            Self::Log(args) => &args.json,
        }
    }
}

/// Options of `import act` and `import robomimic`.
#[derive(Args, Debug)]
pub(crate) struct ImportArgs {
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
    /// Joints and jaw within an episode (7 numbers an arm, of one or two arms: six joint positions
    /// in rad, insertion in m, and the jaw in rad); of act observations/qpos if not given.
    #[arg(long, value_name = "NAME")]
    pub(crate) joints: Option<String>,
    /// Commanded joints and jaw within an episode, alike; of act action if not given.
    #[arg(long, value_name = "NAME", conflicts_with = "action_pose")]
    pub(crate) action_joints: Option<String>,
    /// Commanded tip poses and jaws within an episode instead (8 numbers an arm: position in m,
    /// quaternion x, y, z, w in the arm's RCM frame, jaw in rad).
    #[arg(long, value_name = "NAME")]
    pub(crate) action_pose: Option<String>,
    /// Cameras' frames within an episode, with commas between them: 8-bit RGB, or rows of JPEG. A
    /// camera is called what stands behind the last /, without _image. Of act all in
    /// observations/images if not given.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(crate) images: Vec<String>,
    /// JSON with six rows [twist, length, offset along, offset about, slides] (rad, m; modified
    /// Denavit-Hartenberg) of another arm than a patient-side manipulator with a Large Needle
    /// Driver.
    #[arg(long, value_name = "FILE")]
    pub(crate) dh: Option<PathBuf>,
    /// Bring frames to this size, such as 512x512, without keeping their proportions. Networks take
    /// sizes that are a whole multiple of their own: train's small preset 256x256, lerobot and
    /// paper 512x512.
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

/// Options of `import lerobot`.
#[derive(Args, Debug)]
pub(crate) struct LerobotArgs {
    /// The dataset's directory, or the one with a dVRK's recordings.
    #[arg(value_name = "FOLDER")]
    source: PathBuf,
    /// The table of names: open-h-dvrk, dvrk-raw, or a file.
    #[arg(long, value_name = "NAME|FILE")]
    mapping: String,
    /// The new dataset's directory; a new or an empty one.
    #[arg(long)]
    out: PathBuf,
    /// What the demonstrations show, in words; their instruction if not given, where they have one
    /// alone.
    #[arg(long, value_name = "TEXT", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    task: Option<String>,
    /// Only the episodes of this split of the dataset, such as perfect; all but those of failure if
    /// not given.
    #[arg(long, value_name = "NAME")]
    split: Option<String>,
    /// Frames a second of raw recordings; by their timestamps if not given.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    fps: Option<u32>,
    /// Bring frames to this size, such as 512x512, without keeping their proportions.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    resize: Option<(u32, u32)>,
    /// Keep colour as video instead of as PNG: far smaller, but lossy. Needs
    /// ffmpeg 5.1 or newer, here and where the dataset is read.
    #[arg(long, value_enum, value_name = "CODEC")]
    video: Option<Video>,
    /// Write what was imported as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// `WIDTHxHEIGHT`.
pub(crate) fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        let side = |text: &str| {
            let side = text.parse::<u32>().ok();
            side.filter(|side| (1..=SIDE_MAX).contains(side))
        };
        side(width).zip(side(height))
    });
    sides.ok_or_else(|| format!("a width and a height of 1 to {SIDE_MAX}, such as 512x512"))
}

pub(crate) fn import(verb: &ImportVerb) -> Done {
    match verb {
        ImportVerb::Act(args) => import_hdf5(args, Layout::Act),
        ImportVerb::Robomimic(args) => import_hdf5(args, Layout::Robomimic),
        ImportVerb::Lerobot(args) => import_lerobot(args),
        ImportVerb::Log(args) => import_log(args),
    }
}

/// A result must not go among what is read.
fn check_json(json: Option<&Path>, source: &Path) -> Result<(), SessionError> {
    if let Some(path) = json.filter(|path| path.exists()) {
        let file = path.canonicalize().ok();
        let among = source.canonicalize().ok();
        if file
            .zip(among)
            .is_some_and(|(file, among)| file.starts_with(among))
        {
            let text = format!("--json {}: exists among the demonstrations", path.display());
            return Err(SessionError::BadArgument(text));
        }
    }
    Ok(())
}

fn import_request(args: &LerobotArgs, mapping: Mapping) -> ImportRequest {
    ImportRequest {
        mapping,
        source: args.source.clone(),
        out: args.out.clone(),
        task: args.task.clone(),
        split: args.split.clone(),
        fps: args.fps,
        size: args.resize,
        video: args.video.map(codec),
    }
}

fn import_lerobot(args: &LerobotArgs) -> Done {
    let source = ("the demonstrations", Some(args.source.as_path()));
    let out = ("--out", Some(args.out.as_path()));
    check_json(args.json.as_deref(), &args.source)?;
    outputs::check(&[("--json", args.json.as_deref())], &[source, out])?;
    let mapping = Mapping::read(&args.mapping).map_err(|error| unknown(&args.mapping, error))?;
    outputs::new_folder("--out", &args.out)?;
    let request = import_request(args, mapping);
    let summary = console::with_episodes(|done| import_mapped(&request, done))?;
    let left_out = match summary.left_out {
        0 => String::new(),
        count => format!("; {count} left out"),
    };
    console::result(&format!(
        "{} episodes, {} frames in {}{left_out}",
        summary.episodes,
        summary.frames,
        args.out.display()
    ));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}

/// The error of a mapping; of a name that is neither a file nor built in it says which are.
fn unknown(name: &str, error: ConfigError) -> SessionError {
    if matches!(error, ConfigError::Unreadable { .. }) && !Path::new(name).exists() {
        let known: Vec<&str> = Mapping::built_in().collect();
        let known = known.join(", ");
        let text = format!("--mapping {name}: is no file, and built in are {known}");
        return SessionError::BadArgument(text);
    }
    error.into()
}

fn import_options(args: &ImportArgs, layout: Layout) -> Result<ImportOptions, SessionError> {
    Ok(ImportOptions {
        layout,
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
    })
}

fn import_hdf5(args: &ImportArgs, layout: Layout) -> Done {
    let source = ("the demonstrations", Some(args.source.as_path()));
    let out = ("--out", Some(args.out.as_path()));
    let dh = ("--dh", args.dh.as_deref());
    check_json(args.json.as_deref(), &args.source)?;
    outputs::check(&[("--json", args.json.as_deref())], &[source, out, dh])?;
    outputs::new_folder("--out", &args.out)?;
    let options = import_options(args, layout)?;
    let summary = console::with_episodes(|done| import_demonstrations(&options, done))?;
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
