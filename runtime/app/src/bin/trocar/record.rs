//! `trocar record`: demonstrations until there are enough, or until a signal.

use trocar::rt;
use trocar::session::record::{self, RecordOptions, RecordSummary};
use trocar::session::run::write_json;
use trocar::session::teleop::TIME_FACTOR;
use trocar::session::{Plan, PolicyChoice, SessionError, Setup};
use trocar_data::dataset::Totals;

use crate::args::{Demonstrator, RecordArgs};
use crate::commands::{Done, codec, open_console, task_changes};
use crate::console;
use crate::scene_args::Inputs;

pub(crate) fn record(args: &RecordArgs) -> Done {
    check_source(args)?;
    Inputs::new([
        ("--config", args.config.as_ref()),
        ("--scene", args.scene.scene.as_ref()),
        ("--out", Some(&args.out)),
    ])
    .and_tasks([&args.task])
    .check(&[("--json", args.json.as_deref())])?;
    let changes = task_changes(&args.set)?;
    let demonstrator = match args.source {
        Demonstrator::Expert => PolicyChoice::Expert,
        Demonstrator::Teleop => PolicyChoice::Teleop,
    };
    let scene = args.vary.add_to(args.scene.options(Some(&args.cameras)));
    let config = args.config.as_deref();
    let mut setup = Setup::load_with(&args.task, config, &demonstrator, &scene, changes)?;
    if args.source == Demonstrator::Teleop {
        setup.task.time_limit_s *= TIME_FACTOR;
    }
    let plan = Plan {
        seed: args.seed,
        warn: console::warning,
        ..Plan::new(setup, demonstrator)
    };
    let options = RecordOptions {
        disturb: args.disturb,
        episodes: args.episodes,
        out: args.out.clone(),
        resume: args.resume,
        jobs: args.jobs,
        depth: args.depth,
        video: args.video.map(codec),
        instruction: args.instruction.clone(),
    };
    let page = args.console.map(open_console).transpose()?;
    if page.is_none() {
        rt::catch_interrupts().map_err(SessionError::signals)?;
    }
    let bar = console::progress(args.episodes as u64, "episodes");
    if let (true, Ok(there)) = (args.resume, Totals::read(&args.out)) {
        bar.set_position(there.episodes as u64);
        bar.reset_eta();
    }
    let mut on_attempt = |attempt: &record::Attempt| {
        if attempt.kept {
            bar.inc(1);
        } else {
            bar.suspend(|| {
                console::note(&format!(
                    "seed {}: not kept: {}",
                    attempt.seed, attempt.reason
                ))
            });
        }
    };
    let summary = match &page {
        Some(page) => {
            let recorded = record::record_by_hand(&plan, &options, page, &mut on_attempt);
            let said = recorded.as_ref().map_or_else(ToString::to_string, said);
            page.close(None, &said);
            recorded?
        }
        None => record::record(&plan, &options, &rt::interrupted, &mut on_attempt)?,
    };
    bar.finish_and_clear();
    report(&summary, args);
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(!summary.interrupted)
}

/// A person does one episode at a time, is not disturbed, and is seen by the console.
fn check_source(args: &RecordArgs) -> Result<(), SessionError> {
    let teleop = args.source == Demonstrator::Teleop;
    let wrong = match (teleop, args.console) {
        (true, None) => "--source teleop: the operator's hands come over --console",
        (false, Some(_)) => "--console needs --source teleop: the expert needs no page",
        (true, Some(_)) if args.jobs > 1 => "--jobs: a person does one episode at a time",
        (true, Some(_)) if args.disturb.is_some() => "--disturb needs --source expert",
        _ => return Ok(()),
    };
    Err(SessionError::BadArgument(wrong.to_owned()))
}

/// What pages are told at the end.
fn said(summary: &RecordSummary) -> String {
    format!("{} episodes are recorded", summary.episodes)
}

fn report(summary: &RecordSummary, args: &RecordArgs) {
    let (episodes, before) = (summary.episodes, summary.episodes_before);
    let out = args.out.display();
    let there = match before {
        0 => String::new(),
        _ if before >= args.episodes => "; all were there before, nothing was recorded".to_owned(),
        _ => format!("; {before} were there before"),
    };
    console::result(&format!(
        "{episodes} episodes, {} steps in {out}{there}",
        summary.steps
    ));
    if let Some(disturbed) = &summary.disturbed {
        console::result(&format!(
            "disturbed: {} of {} kept, {} with another attempt at a grasp",
            disturbed.kept, disturbed.attempts, disturbed.retried
        ));
    }
    if summary.interrupted {
        let asked = args.episodes;
        console::note(&format!(
            "trocar: interrupted: {episodes} of {asked} episodes are in {out}; the same command with --resume goes on"
        ));
    }
}
