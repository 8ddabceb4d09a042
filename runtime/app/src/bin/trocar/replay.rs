//! `trocar replay`: a log recomputed and shown, or a dataset. With `--console` or `--foxglove` it
//! stays until Ctrl-C, and shows a log also if it differs from what is computed again.

use serde::Serialize;
use trocar::rt;
use trocar::session::SessionError;
use trocar::session::run::write_json;
use trocar_data::dataset::Dataset;
use trocar_log::replay::{self as replaying, KeptFrom, ReplayResult};

use crate::args::{LogArgs, ReplayArgs};
use crate::commands::{Done, check_result, forget_result, refuse_cut};
use crate::console;

/// Time between two looks at whether a signal has come, ns.
const CONSOLE_POLL_NS: u64 = 50_000_000;

/// A folder is taken for a dataset, anything else for a log.
///
/// # Errors
/// What can't be read; of a log that was cut off also, after what there is has been recomputed.
pub(crate) fn replay(args: &ReplayArgs) -> Done {
    if args.log.file.is_dir() {
        return look_through(args);
    }
    let page = args.page.open(args.viewers.foxglove)?;
    let replayed = replay_log(&args.log);
    let Some(page) = page else {
        return replayed;
    };
    // A log that differs, or ends too early, is what one wants to see.
    if matches!(&replayed, Ok(_) | Err(SessionError::CutLog { .. })) {
        page.show_log(&args.log.file)?;
        until_interrupted("the log")?;
    }
    page.close(None, "the console has been closed");
    replayed
}

/// What `replay` says of a dataset.
#[derive(Serialize)]
struct DatasetResult<'a> {
    task: &'a str,
    episodes: usize,
    frames: usize,
}

/// Reads a dataset and shows its episodes: there is nothing in them to recompute.
fn look_through(args: &ReplayArgs) -> Done {
    check_result(&args.log)?;
    forget_result(&args.log)?;
    let dir = &args.log.file;
    if args.viewers.foxglove.is_some() {
        return Err(SessionError::BadArgument(format!(
            "{}: a folder is a dataset, which has no --foxglove",
            dir.display()
        )));
    }
    let page = args.page.open(None)?;
    let dataset = Dataset::open(dir)?;
    let result = DatasetResult {
        task: dataset.task(),
        episodes: dataset.episodes().len(),
        frames: dataset.len(),
    };
    let DatasetResult {
        task,
        episodes,
        frames,
    } = &result;
    console::result(&format!("{task}: {episodes} episodes, {frames} frames"));
    if let Some(path) = &args.log.json {
        write_json(path, &result)?;
    }
    if let Some(page) = page {
        page.show_dataset(dir)?;
        until_interrupted("the dataset")?;
        page.close(None, "the console has been closed");
    }
    Ok(true)
}

/// Waits for Ctrl-C while a page shows `what`. A page that is closed meanwhile may be opened again.
fn until_interrupted(what: &str) -> Result<(), SessionError> {
    rt::catch_interrupts().map_err(SessionError::signals)?;
    console::note(&format!("trocar: {what} is shown; Ctrl-C ends it"));
    while !rt::interrupted() {
        rt::sleep_ns(CONSOLE_POLL_NS);
    }
    Ok(())
}

/// Recomputes every tick of the log with the controller of its configuration and compares commands
/// bit for bit; the first difference is printed and makes it fail.
///
/// # Errors
/// A log that can't be read, or one that is cut off. One that its own bound has cut is whole as far
/// as it goes, if the inputs of what it kept could be checked.
fn replay_log(args: &LogArgs) -> Done {
    check_result(args)?;
    forget_result(args)?;
    let result = replaying::replay_file::<SessionError>(&args.file)?;
    match &result.first_difference {
        None if result.identical => console::result(&identical(&result)),
        None => console::result(&format!("not identical after {} ticks", result.ticks)),
        Some(gap) if gap.is_gap() => console::result(&format!(
            "ends at a gap: tick {}: {}; {} ticks before it are identical",
            gap.tick, gap.logged, result.ticks
        )),
        Some(difference) => console::result(&format!("differs: {difference}")),
    }
    if let Some(path) = &args.json {
        write_json(path, &result)?;
    }
    // What a bound left out is said, and is nothing that is wrong with what it kept.
    let is_whole_part = result.bounded && result.inputs_checked;
    let cut = result.cut.as_deref().filter(|_| !is_whole_part);
    refuse_cut(cut, args)?;
    Ok(result.identical)
}

/// How far a log is identical.
fn identical(result: &ReplayResult) -> String {
    let ticks = result.ticks;
    match (result.kept_from, result.bounded) {
        (Some(KeptFrom { left_out, at_s }), _) => {
            let edge = if result.edge_checked {
                "; it begins where the file before ends"
            } else {
                ""
            };
            format!(
                "identical: {ticks} ticks from {at_s:.3} s on; the beginning ({left_out} ticks) was not kept{edge}"
            )
        }
        (None, true) => format!("identical: {ticks} ticks; the run goes on in another file"),
        (None, false) => format!("identical: {ticks} ticks"),
    }
}
