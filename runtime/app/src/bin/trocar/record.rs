//! `trocar record`: demonstrations until there are enough, or until a signal.

use trocar::rt;
use trocar::session::record::{self, RecordOptions, RecordSummary};
use trocar::session::run::write_json;
use trocar::session::{Plan, PolicyChoice, SessionError, Setup};
use trocar_data::dataset::Totals;

use crate::args::RecordArgs;
use crate::commands::{Done, codec, task_changes};
use crate::console;
use crate::scene_args::Inputs;

pub(crate) fn record(args: &RecordArgs) -> Done {
    Inputs::new([
        ("--config", args.config.as_ref()),
        ("--scene", args.scene.scene.as_ref()),
        ("--out", Some(&args.out)),
    ])
    .and_tasks([&args.task])
    .check(&[("--json", args.json.as_deref())])?;
    let changes = task_changes(&args.set)?;
    let expert = PolicyChoice::Expert;
    let scene = args.vary.add_to(args.scene.options(Some(&args.cameras)));
    let setup = Setup::load_with(&args.task, args.config.as_deref(), &expert, &scene, changes)?;
    let plan = Plan {
        seed: args.seed,
        ..Plan::new(setup, expert)
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
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let bar = console::progress(args.episodes as u64, "episodes");
    if let (true, Ok(there)) = (args.resume, Totals::read(&args.out)) {
        bar.set_position(there.episodes as u64);
        bar.reset_eta();
    }
    let summary = record::record(&plan, &options, &rt::interrupted, &mut |attempt| {
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
    })?;
    bar.finish_and_clear();
    report(&summary, args);
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(!summary.interrupted)
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
