//! Sessions of two arms in lockstep, what refuses them, and what a soft tissue adds to the results.

use hal::Chunk;
use sim_backend::simulation::{Rendering, Simulation};
use tch::Device;

use super::episode::{Episode, EpisodeEnd, Plan, Watcher};
use super::eval::{EvalOptions, evaluate};
use super::realtime::run_realtime;
use super::record::{RecordOptions, record};
use super::run::RunOptions;
use super::{PolicyChoice, Setup};
use crate::log::tests::Scratch;
use crate::log::{Pressure, Recorder, RunHeader, RunLog, RunOutcome, TickRecord};
use crate::replay::replay;
use crate::verify::verify;

/// Writes the log of an episode without looking at it.
struct Logger(Recorder);

impl Watcher for Logger {
    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        self.0.chunk(arm, chunk);
    }

    fn tick(&mut self, record: &TickRecord) {
        self.0.tick(record);
    }
}

fn handover(policy: &PolicyChoice) -> Setup {
    Setup::load("needle-handover", None, policy).unwrap()
}

/// The first `ticks` of the handover under `policy`, with a log.
fn run(policy: &PolicyChoice, ticks: u64, file: &Scratch) -> (EpisodeEnd, RunLog) {
    let setup = handover(policy);
    let texts = [
        ("control.toml", setup.texts.control.clone()),
        ("safety.toml", setup.texts.safety.clone()),
    ];
    let header = RunHeader {
        texts: texts.map(|(name, text)| (name.to_owned(), text)).into(),
        ..RunHeader::default()
    };
    let mut logger = Logger(Recorder::create(&file.0, &header, Pressure::Block).unwrap());
    let episode = Episode {
        simulation: &mut Simulation::new(&setup.task, 3, Rendering::Off).unwrap(),
        controller: &mut setup.controller().unwrap(),
        source: &mut setup.source(policy, 3, Device::Cpu).unwrap(),
    };
    let plan = Plan {
        latency_ticks: 40,
        tick_limit: ticks,
    };
    let end = episode.run(&plan, &mut logger).unwrap();
    let outcome = RunOutcome {
        command_hash: end.tally.command_hash(),
        ..RunOutcome::default()
    };
    logger.0.finish(Some(&outcome)).unwrap();
    (end, RunLog::open(&file.0).unwrap())
}

#[test]
fn two_arms_run_replay_and_verify_under_every_policy_without_a_network() {
    // The expert's second arm waits for its turn.
    for (policy, ticks) in [
        (PolicyChoice::Expert, 12_000),
        (PolicyChoice::Noop, 1000),
        (PolicyChoice::Random, 2000),
    ] {
        let name = policy.name();
        let file = Scratch::new(&format!("session-two-{name}"));
        let (end, log) = run(&policy, ticks, &file);
        assert_eq!(end.tally.fault(), None, "{name}");
        let replayed = replay(&log).unwrap();
        assert!(
            replayed.identical && replayed.inputs_checked && replayed.ticks == end.tally.ticks(),
            "{name}: {replayed:?}"
        );
        let verified = verify(&log).unwrap();
        assert!(verified.ok, "{name}: {:?}", verified.violations.first());
        let path_m = |arm: usize| {
            let speeds = log.ticks().filter_map(|(tick, _)| tick.arms.get(arm));
            speeds.fold(0.0, |sum, arm| sum + arm.command.velocity.norm() * 1e-3)
        };
        let moved = [path_m(0) > 0.01, path_m(1) > 0.01];
        let expected = match policy {
            PolicyChoice::Noop => [false, false],
            PolicyChoice::Expert | PolicyChoice::Random | PolicyChoice::Checkpoint(_) => {
                [true, true]
            }
        };
        assert_eq!(moved, expected, "{name}");
        let chunks = log
            .ticks()
            .filter(|(_, chunks)| chunks.first.is_some() && matches!(chunks.second, Some(Some(_))));
        assert!(chunks.count() > 5, "{name}");
    }
}

#[test]
fn the_same_seed_gives_the_same_hash_of_both_arms() {
    let (file, other) = (
        Scratch::new("session-two-once"),
        Scratch::new("session-two-twice"),
    );
    let (once, _) = run(&PolicyChoice::Random, 600, &file);
    let (twice, _) = run(&PolicyChoice::Random, 600, &other);
    assert_eq!(once.tally.command_hash(), twice.tally.command_hash());
}

#[test]
fn what_knows_one_arm_refuses_two_and_says_what_to_do() {
    let setup = handover(&PolicyChoice::Expert);
    let options = RunOptions {
        policy: PolicyChoice::Expert,
        seed: 1,
        log: None,
        pictures: false,
        latency_ms: None,
        device: Device::Cpu,
    };
    let error = run_realtime(&setup, &options).unwrap_err();
    assert!(error.is_bad_input() && error.to_string().contains("use --lockstep"));
    let out = std::env::temp_dir().join("trocar-no-two-armed-dataset");
    let options = RecordOptions {
        episodes: 1,
        out: out.clone(),
        seed: 1,
        jobs: 1,
    };
    let error = record(&setup, &options, &mut |_| {}).unwrap_err();
    assert!(error.is_bad_input() && !out.exists(), "{error}");
    let network = PolicyChoice::Checkpoint(out);
    let Err(error) = setup.source(&network, 1, Device::Cpu) else {
        panic!("a network for two arms")
    };
    assert!(error.is_bad_input() && error.to_string().contains("2 arms"));
}

fn evaluated(
    task: &str,
    policy: PolicyChoice,
    seed: u64,
    limit_s: Option<f64>,
) -> serde_json::Value {
    let mut setup = Setup::load(task, None, &policy).unwrap();
    setup.task.time_limit_s = limit_s.unwrap_or(setup.task.time_limit_s);
    let options = EvalOptions {
        policy,
        trials: 1,
        seed,
        jobs: 1,
        latency_ms: None,
        device: Device::Cpu,
    };
    let summary = evaluate(&setup, &options, &mut |_| {}).unwrap();
    serde_json::to_value(&summary).unwrap()
}

#[test]
fn expert_retracts_the_flap_through_the_whole_chain_and_the_tissue_is_reported() {
    let result = evaluated("tissue-retraction", PolicyChoice::Expert, 1, None);
    assert_eq!(result["successes"], 1, "{result}");
    let tissue = &result["episodes"][0]["tissue"];
    let value = |key: &str| tissue[key].as_f64().unwrap();
    assert!((0.03..0.8).contains(&value("force_n_max")), "{tissue}");
    assert!((0.005..0.4).contains(&value("stretch_max")), "{tissue}");
    assert!((0.02..0.03).contains(&value("mark_rise_m_max")), "{tissue}");
}

#[test]
fn nobody_retracts_the_flap_by_doing_nothing_or_anything() {
    for policy in [PolicyChoice::Noop, PolicyChoice::Random] {
        // Longer than the expert takes.
        let result = evaluated("tissue-retraction", policy, 1, Some(6.0));
        assert_eq!(result["successes"], 0, "{result}");
    }
}

#[test]
fn tasks_without_a_tissue_report_none() {
    let result = evaluated("needle-lift", PolicyChoice::Noop, 1, Some(1.0));
    let episode = result["episodes"][0].as_object().unwrap();
    assert!(!episode.contains_key("tissue"), "{result}");
}
