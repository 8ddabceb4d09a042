//! The verb `import log`.

use std::path::PathBuf;

use clap::Args;

use trocar::session::import_log::{LogImportOptions, import_logs};
use trocar::session::run::write_json;
use trocar::session::{SessionError, outputs};

use crate::args::Video;
use crate::commands::{Done, codec};
use crate::console;
use crate::import::size;

/// Options of `import log`.
#[derive(Args, Debug)]
pub(crate) struct ImportLogArgs {
    /// The logs, an episode each, in this order.
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,
    /// What the demonstrations show, in words.
    #[arg(long, value_name = "TEXT", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    task: String,
    /// The dataset's directory; a new or an empty one.
    #[arg(long)]
    out: PathBuf,
    /// Steps a second. No more than the cameras have frames: logs of simulated runs have 25 in
    /// lockstep, in real time 5 or as many as the policy is shown.
    #[arg(long, default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..=1000))]
    fps: u32,
    /// The cameras, with commas between them; the steps are frames of the first. All that the first
    /// log has if not given.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    cameras: Vec<String>,
    /// Bring frames to this size, such as 512x512, without keeping their proportions.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    resize: Option<(u32, u32)>,
    /// Keep colour as video instead of as PNG: far smaller, but lossy. Needs
    /// ffmpeg 5.1 or newer, here and where the dataset is read.
    #[arg(long, value_enum, value_name = "CODEC")]
    video: Option<Video>,
    /// Take runs whose task was not done, that their operator marked as failures, or in which an
    /// arm had a fault, too. A robot's runs without a mark are taken but for faults; one that was
    /// discarded is never taken.
    #[arg(long)]
    failures: bool,
    /// Write what was imported as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// One log twice would count twice, and one camera can't be two.
fn check_once<T: PartialEq>(
    option: &str,
    given: &[T],
    name: fn(&T) -> String,
) -> Result<(), SessionError> {
    for (index, value) in given.iter().enumerate() {
        if given[..index].contains(value) {
            let text = format!("{option} {}: is given twice", name(value));
            return Err(SessionError::BadArgument(text));
        }
    }
    Ok(())
}

pub(crate) fn import_log(args: &ImportLogArgs) -> Done {
    let logs = args.logs.iter().map(|log| ("LOG", Some(log.as_path())));
    let others: Vec<_> = logs.chain([("--out", Some(args.out.as_path()))]).collect();
    let files: Vec<PathBuf> = args.logs.iter().map(|log| outputs::identity(log)).collect();
    check_once("LOG", &files, |log| log.display().to_string())?;
    check_once("--cameras", &args.cameras, String::clone)?;
    outputs::check(&[("--json", args.json.as_deref())], &others)?;
    outputs::new_folder("--out", &args.out)?;
    let options = LogImportOptions {
        logs: args.logs.clone(),
        out: args.out.clone(),
        task: args.task.clone(),
        fps: args.fps,
        cameras: args.cameras.clone(),
        size: args.resize,
        video: args.video.map(codec),
        failures: args.failures,
    };
    let summary = console::with_episodes(|done| import_logs(&options, done))?;
    let left_out = match summary.left_out {
        0 => String::new(),
        count => format!("; {count} failed and left out"),
    };
    let discarded = match summary.discarded.as_slice() {
        [] => String::new(),
        logs => {
            let logs = logs.iter().map(|log| log.display().to_string());
            let logs = logs.collect::<Vec<_>>().join(", ");
            format!("; discarded by the operator and left out: {logs}")
        }
    };
    let by_hand = match summary.by_hand {
        0 => String::new(),
        count => format!("; an operator drove in {count}"),
    };
    console::result(&format!(
        "{} episodes, {} frames in {}{by_hand}{left_out}{discarded}",
        summary.episodes,
        summary.frames,
        args.out.display()
    ));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}
