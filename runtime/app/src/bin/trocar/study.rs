//! `trocar study` and `trocar report`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, Parser};

use trocar::session::{SessionError, outputs};
use trocar::study::commands::CommandLine;
use trocar::study::plan::Shard;
use trocar::study::schedule::Machine;
use trocar::study::session::{Options, Study, default_folder};
use trocar::{report, rt};

use crate::args::Cli;
use crate::commands::Done;
use crate::console;

/// Options of `study`.
#[derive(Args, Debug)]
pub(crate) struct StudyArgs {
    /// The study's file, such as config/studies/sufia-bc.toml.
    #[arg(value_name = "FILE.toml")]
    pub(crate) file: PathBuf,
    /// The study's folder, where cells are kept and looked for; runs/NAME for NAME.toml if not
    /// given.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Run this part of it: the i-th of n, from 1. Shards may share a folder, or have one each,
    /// which `report` takes together.
    #[arg(long, value_name = "I/N")]
    pub(crate) shard: Option<Shard>,
    /// List the cells and how they stand, and run nothing.
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Cores that cells share; all if not given.
    #[arg(long, value_name = "CORES", value_parser = RangedU64ValueParser::<usize>::new().range(1..=4096))]
    pub(crate) jobs: Option<usize>,
    /// GPUs that cells share, as CUDA_VISIBLE_DEVICES names them, with commas between them; all
    /// that this libtorch sees if not given.
    #[arg(long, value_name = "LIST")]
    pub(crate) gpus: Option<String>,
    /// A label that stands for the program in the cells' hashes. If not given, the executable's
    /// hash does: after any change of it everything is made anew. With a label you vouch that all
    /// programs of that label give the same results.
    #[arg(long, value_name = "LABEL")]
    pub(crate) code: Option<String>,
}

/// The parser of this program.
struct OwnParser;

impl CommandLine for OwnParser {
    fn check(&self, arguments: &[OsString]) -> Result<(), String> {
        let line = std::iter::once(OsString::from("trocar")).chain(arguments.iter().cloned());
        Cli::try_parse_from(line).map(drop).map_err(|error| {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or_default();
            first.trim_start_matches("error: ").to_owned()
        })
    }
}

/// `trocar study`. Done if nothing failed and it was not interrupted; cells that were done before
/// count as done.
///
/// # Errors
/// A study's file that is wrong; a cell whose files are not what was written, named after all
/// others have been made.
pub(crate) fn study(args: &StudyArgs) -> Done {
    let executable = std::env::current_exe();
    let executable = executable.map_err(|error| {
        SessionError::RealTime(format!("this program's own file can't be found: {error}"))
    })?;
    let options = Options {
        file: args.file.clone(),
        out: args
            .out
            .clone()
            .unwrap_or_else(|| default_folder(&args.file)),
        shard: args.shard,
        code: args.code.clone(),
        executable,
        machine: machine(args),
    };
    let study = Study::open(options, &OwnParser)?;
    if args.dry_run {
        for line in study.list() {
            console::result(&line);
        }
        return Ok(true);
    }
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let outcome = study.run(&mut |line| console::note(line))?;
    console::result(&format!(
        "{} cells done before, {} now, {} failed, {} damaged, {} skipped{}",
        outcome.found,
        outcome.made,
        outcome.failed.len(),
        outcome.damaged.len(),
        outcome.skipped,
        if outcome.interrupted {
            "; interrupted"
        } else {
            ""
        }
    ));
    for (cell, reason) in &outcome.failed {
        console::result(&format!("failed: {cell}: {reason}"));
    }
    if let Some((cell, reason)) = outcome.damaged.first() {
        return Err(SessionError::BadArgument(format!(
            "{cell}: {reason}; put back what was there, or move the cell's folder away so that it is made anew"
        )));
    }
    Ok(outcome.failed.is_empty() && !outcome.interrupted)
}

/// What cells share: `--jobs` cores and `--gpus`, or all that there are.
fn machine(args: &StudyArgs) -> Machine {
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    let gpus = match &args.gpus {
        Some(list) => names(list),
        None => visible_gpus(),
    };
    Machine {
        cores: args.jobs.unwrap_or(all),
        gpus,
    }
}

/// `list` at its commas, without spaces and empty names.
fn names(list: &str) -> Vec<String> {
    let names = list
        .split(',')
        .map(str::trim)
        .filter(|name| !name.is_empty());
    names.map(str::to_owned).collect()
}

/// The GPUs that this process may use, by the names that its children take.
fn visible_gpus() -> Vec<String> {
    let count = usize::try_from(tch::Cuda::device_count()).unwrap_or(0);
    match std::env::var("CUDA_VISIBLE_DEVICES") {
        Ok(list) => names(&list).into_iter().take(count).collect(),
        Err(_) => (0..count).map(|index| index.to_string()).collect(),
    }
}

/// Options of `report`.
#[derive(Args, Debug)]
pub(crate) struct ReportArgs {
    /// The study's folder; those of its shards, if they have one each.
    #[arg(value_name = "DIR", required = true)]
    pub(crate) folders: Vec<PathBuf>,
    /// The report: one HTML file, or Markdown with its images in a folder beside it. Parent folders
    /// are made.
    #[arg(long, value_name = "FILE.html|FILE.md")]
    pub(crate) out: PathBuf,
    /// Write the figures of its tables as JSON, to standard output if it is `-`; parent folders are
    /// made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

pub(crate) fn report(args: &ReportArgs) -> Done {
    let json = ("--json", args.json.as_deref());
    outputs::check(&[("--out", Some(args.out.as_path())), json], &[])?;
    let folders: Vec<PathBuf> = args
        .folders
        .iter()
        .map(|folder| std::path::absolute(folder).unwrap_or_else(|_| folder.clone()))
        .collect();
    let written = report::write(&folders, &args.out, args.json.as_deref())?;
    let [done, all] = written.evaluations;
    console::result(&format!(
        "{}: {done} of {all} evaluations",
        args.out.display()
    ));
    for reason in &written.damaged {
        console::warning(&format!("left out: {reason}"));
    }
    if let Some(reason) = written.damaged.first() {
        return Err(SessionError::BadArgument(format!(
            "{reason}; the report was written without it: put back what was there, or move the cell's folder away and run `trocar study` again"
        )));
    }
    Ok(true)
}
