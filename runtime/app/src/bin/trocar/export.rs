//! The verb `export`. A dataset of ours in the form of another project's.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use trocar::session::run::write_json;
use trocar::session::{SessionError, outputs};
use trocar_data::dataset::{Notes, VideoCodec};
use trocar_data::export::{ExportOptions, export_open_h};

use crate::args::Video;
use crate::commands::{Done, codec};
use crate::console;
use crate::provenance::provenance;

/// Whose form a dataset is brought to.
#[derive(Debug, Subcommand)]
pub(crate) enum ExportVerb {
    /// Open-H-Embodiment's: LeRobot v2.1 with the names, units and notes of its dVRK datasets.
    #[command(
        after_help = "Example: trocar export open-h runs/demos --out runs/open-h\n         trocar export open-h runs/demos --out runs/open-h --instruction \"Pick up the needle\" --tools \"Large Needle Driver\"\n\nStates and actions are tip poses and jaws in the arm's base frame (m, quaternion x, y, z, w, rad); joints come along, depth does not. Episodes that were disturbed come behind the others, as the split recovery; those of --failures come last, as the split failure. Licence, institution and the like are to be filled in, in brackets, in OUT/meta/README.md."
    )]
    OpenH(OpenHArgs),
}

impl ExportVerb {
    /// Where the result goes as JSON.
    pub(crate) const fn json(&self) -> &Option<PathBuf> {
        let Self::OpenH(args) = self;
        &args.json
    }
}

/// Options of `export open-h`.
#[derive(Args, Debug)]
pub(crate) struct OpenHArgs {
    /// The dataset's directory.
    #[arg(value_name = "DATASET")]
    dataset: PathBuf,
    /// A dataset of attempts that failed, such as `trocar record --failures` makes: they come along
    /// as the split failure, and are in no other. It must have the arms, the rate and the cameras
    /// of the first.
    #[arg(long, value_name = "DIR")]
    failures: Option<PathBuf>,
    /// The new dataset's directory; a new or an empty one.
    #[arg(long)]
    out: PathBuf,
    /// What the demonstrations show, in words; the dataset's own if not given.
    #[arg(long, value_name = "TEXT", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    instruction: Option<String>,
    /// The instrument of psm1, and of psm2 behind a comma if it is another. If not given, that of
    /// the simulator for its recordings, and a gap to be filled in for others.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    tools: Vec<String>,
    /// How colour is compressed; h264 if not given. Needs ffmpeg 5.1 or newer.
    #[arg(long, value_enum, value_name = "CODEC")]
    video: Option<Video>,
    /// Write what was exported as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// `trocar export open-h`. All checks come before the folder is made: two datasets that are one, an
/// output inside of its own input, a `--json` that would overwrite something.
///
/// # Errors
/// Such options; a dataset that can't be read; `ffmpeg` that is missing or fails.
pub(crate) fn export(verb: &ExportVerb) -> Done {
    let ExportVerb::OpenH(args) = verb;
    let dataset = ("the dataset", Some(args.dataset.as_path()));
    let out = ("--out", Some(args.out.as_path()));
    let failures = ("--failures", args.failures.as_deref());
    let files = [dataset, failures, out];
    outputs::check(&[("--json", args.json.as_deref())], &files)?;
    if let Some(failures) = &args.failures
        && let (Ok(one), Ok(other)) = (args.dataset.canonicalize(), failures.canonicalize())
        && one == other
    {
        let text = format!("--failures {}: is the dataset itself", failures.display());
        return Err(SessionError::BadArgument(text));
    }
    for dataset in [&args.dataset].into_iter().chain(&args.failures) {
        if let (Ok(within), Ok(dataset)) = (args.out.canonicalize(), dataset.canonicalize())
            && within.starts_with(&dataset)
        {
            let text = format!("--out {}: is in the dataset itself", args.out.display());
            return Err(SessionError::BadArgument(text));
        }
    }
    let notes = Notes::read(&args.dataset)?;
    let provenance = provenance(&notes);
    let tools = match (args.tools.is_empty(), &notes.options) {
        (true, Some(_)) => vec!["Large Needle Driver".to_owned()],
        (true, None) => vec!["[instrument]".to_owned()],
        (false, _) => args.tools.clone(),
    };
    outputs::new_folder("--out", &args.out)?;
    let options = ExportOptions {
        dataset: args.dataset.clone(),
        failures: args.failures.clone(),
        out: args.out.clone(),
        instruction: args.instruction.clone(),
        tools,
        video: args.video.map_or(VideoCodec::H264, codec),
        provenance,
    };
    let summary = console::with_episodes(|done| export_open_h(&options, done))?;
    for warning in &summary.warnings {
        console::warning(&format!("Open-H-Embodiment: {warning}"));
    }
    console::result(&format!(
        "{} episodes, {} frames in {}; to be filled in: {}",
        summary.episodes,
        summary.frames,
        args.out.display(),
        args.out.join("meta/README.md").display()
    ));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}
