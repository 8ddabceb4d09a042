//! A simulated operator lifts the needle in lockstep through the path of teleoperation.

use trocar_data::dataset::Notes;

use super::{EpisodeEnd, Scratch, record_one, run_setup, training_options};
use crate::session::teleop::OperatorFigures;
use crate::session::training::train;
use crate::session::{Plan, PolicyChoice, Setup};
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_render::Shading;
use trocar_tasks::task::Outcome;

/// The needle lift by an operator with `figures`, of `ticks` at most.
fn lift(figures: OperatorFigures, ticks: u64, name: &str) -> (EpisodeEnd, RunLog) {
    let file = Scratch::new(&format!("session-operator-{name}"));
    let policy = PolicyChoice::Operator(figures);
    let mut setup = Setup::load("needle-lift", None, &policy).unwrap();
    setup.task.time_limit_s *= policy.time_factor();
    run_setup(&setup, &policy, ticks, &file)
}

/// It lifts the needle, the log replays, and no limit is broken.
#[test]
fn simulated_operator_lifts_the_needle_within_all_limits() {
    let (end, log) = lift(OperatorFigures::default(), 20_000, "lift");
    assert_eq!(
        (&end.outcome, end.tally.faults()),
        (&Outcome::Success, None)
    );
    // The expert takes 4.7 s.
    assert!(
        (6_000..14_000).contains(&end.tally.ticks()),
        "{}",
        end.tally.ticks()
    );
    let replayed = replay(&log).unwrap();
    assert!(
        replayed.identical && replayed.inputs_checked,
        "{replayed:?}"
    );
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations.first());
}

/// The seed decides what hands do, and so do delay, tremor and noise.
#[test]
fn simulated_operator_repeats_and_each_figure_counts() {
    let shipped = OperatorFigures::default();
    let hash = |figures, name: &str| lift(figures, 3_000, name).0.tally.command_hash();
    let known = hash(shipped, "once");
    assert_eq!(known, hash(shipped, "twice"));
    for (name, other) in [
        (
            "late",
            OperatorFigures {
                delay_ms: 160,
                ..shipped
            },
        ),
        (
            "steady",
            OperatorFigures {
                tremor_mm: 0.0,
                ..shipped
            },
        ),
        (
            "exact",
            OperatorFigures {
                noise: 0.0,
                ..shipped
            },
        ),
    ] {
        assert_ne!(known, hash(other, name), "{name}");
    }
}

/// What it demonstrates is a dataset like any other, says who did it, and trains.
#[test]
fn simulated_operator_s_demonstration_names_it_and_trains() {
    let folder = Scratch::new("session-operator-record");
    let (data, out) = (folder.0.join("data"), folder.0.join("act"));
    let policy = PolicyChoice::parse("simulated-operator");
    let policy = policy.operated(None, Some(0.2)).unwrap();
    let mut setup = Setup::load("suture-pad", None, &policy).unwrap();
    setup.task.shading = Shading::Plain;
    for camera in &mut setup.task.cameras {
        (camera.width, camera.height) = (256, 256);
    }
    let frames = record_one(Plan::new(setup, policy), &data).len();
    assert!(frames > 150, "{frames}");
    let notes = Notes::read(&data).unwrap();
    let (recording, options) = (notes.recording.unwrap(), notes.options.unwrap());
    for note in [&recording, &options, &notes.episodes[0]] {
        assert_eq!(note["source"], "simulated-operator", "{note}");
    }
    assert_eq!(recording["operator"]["delay_ms"], 80);
    assert_eq!(options["operator_tremor_mm"], 0.2);
    let hands = &notes.episodes[0]["teleop"];
    assert_eq!(hands["forced_releases"], 0, "{hands}");
    // The way is longer than a hand goes in comfort.
    assert!(hands["engagements"].as_u64() > Some(1), "{hands}");
    let trained = train(&training_options(data, out), &mut |_| {}).unwrap();
    assert!(trained.loss.is_finite());
}

/// What a simulated operator is like is no matter of other policies.
#[test]
fn other_policies_have_no_operator() {
    let error = PolicyChoice::Expert.operated(Some(80), None).unwrap_err();
    assert!(error.to_string().contains("expert is another"), "{error}");
}
