//! Sessions of two arms in lockstep: runs, recordings, and networks trained on them.

use std::fs;
use std::path::{Path, PathBuf};

use hal::Chunk;
use nalgebra::Vector3;
use tch::Device;
use trocar_data::dataset::Dataset;
use trocar_nets::act::BackboneNorm;
use trocar_render::Shading;
use trocar_tasks::simulation::{Rendering, Simulation};

use super::episode::{Episode, EpisodeEnd, EpisodeObserver, Timing};
use super::latency::Latency;
use super::record::{RecordOptions, record};
use super::scratch::Scratch;
use super::training::{
    CameraChoice, NetworkChoice, TrainingOptions, query_every, train, train_options,
};
use super::{Plan, PolicyChoice, Setup};
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{Pressure, Recorder, RunHeader, RunLog, RunOutcome, TickRecord};

mod backbone;
mod clouds;
mod disturbed;
mod failures;
mod joined;
mod latency;
mod logged;
mod operator;
mod own;
mod resumed;
mod state;
mod tissue;

/// Writes the log of an episode without looking at it.
struct Logger(Recorder);

impl EpisodeObserver for Logger {
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
    run_setup(&handover(policy), policy, ticks, file)
}

fn run_setup(
    setup: &Setup,
    policy: &PolicyChoice,
    ticks: u64,
    file: &Scratch,
) -> (EpisodeEnd, RunLog) {
    let texts = [
        ("control.toml", setup.robot.texts.control.clone()),
        ("safety.toml", setup.robot.texts.safety.clone()),
    ];
    let header = RunHeader {
        texts: texts.map(|(name, text)| (name.to_owned(), text)).into(),
        ..RunHeader::default()
    };
    let mut logger = Logger(Recorder::create(&file.0, &header, Pressure::Block).unwrap());
    let rendering = match policy {
        PolicyChoice::Checkpoint(_) | PolicyChoice::Own(_) | PolicyChoice::External(_) => {
            Rendering::On
        }
        PolicyChoice::Expert
        | PolicyChoice::Noop
        | PolicyChoice::Random
        | PolicyChoice::Teleop
        | PolicyChoice::Operator(_) => Rendering::Off,
    };
    // A chunk of hands is over after 40 ms.
    let by_hand = matches!(policy, PolicyChoice::Operator(_));
    let late_ticks = if by_hand { 0 } else { 40 };
    let episode = Episode {
        simulation: &mut Simulation::new(&setup.task, 3, rendering).unwrap(),
        controller: &mut setup.controller().unwrap(),
        source: &mut setup.source(policy, 3, Device::Cpu).unwrap(),
    };
    let timing = Timing {
        latency: Latency::fixed(late_ticks),
        tick_limit: ticks,
    };
    let end = episode.run(&timing, &mut logger).unwrap();
    let outcome = RunOutcome {
        command_hash: end.tally.command_hash(),
        ..RunOutcome::default()
    };
    logger.0.finish(Some(&outcome)).unwrap();
    (end, RunLog::open(&file.0).unwrap())
}

/// Two arms run replay and verify under every policy without a network.
#[test]
fn two_arms_run_replay_and_verify_without_a_network() {
    // The expert's second arm waits for its turn.
    for (policy, ticks) in [
        (PolicyChoice::Expert, 12_000),
        (PolicyChoice::Noop, 1000),
        (PolicyChoice::Random, 2000),
    ] {
        let name = policy.name();
        let file = Scratch::new(&format!("session-two-{name}"));
        let (end, log) = run(&policy, ticks, &file);
        assert_eq!(end.tally.faults(), None, "{name}");
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
            PolicyChoice::Expert
            | PolicyChoice::Random
            | PolicyChoice::Teleop
            | PolicyChoice::Operator(_)
            | PolicyChoice::Checkpoint(_)
            | PolicyChoice::Own(_)
            | PolicyChoice::External(_) => [true, true],
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

/// A checkpoint of one arm.
const COMMITTED: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../config/policies/needle-lift/act-compact"
);

/// A network of another number of arms is refused with both numbers.
#[test]
fn network_of_another_arm_count_is_refused() {
    let folder = Scratch::new("session-arms");
    fs::create_dir_all(&folder.0).unwrap();
    let recipe = Path::new(COMMITTED).join("trocar.json");
    let one: serde_json::Value = serde_json::from_slice(&fs::read(recipe).unwrap()).unwrap();
    let mut two = one;
    two["arms"] = 2.into();
    // The recipe alone decides: the weights are not even there.
    fs::write(folder.0.join("trocar.json"), two.to_string()).unwrap();
    for (task, checkpoint, expected) in [
        (
            "needle-handover",
            Path::new(COMMITTED),
            "arms = 1, task needle-handover has 2",
        ),
        (
            "needle-lift",
            folder.0.as_path(),
            "arms = 2, task needle-lift has 1",
        ),
    ] {
        let policy = PolicyChoice::Checkpoint(checkpoint.to_owned());
        let setup = Setup::load(task, None, &policy).unwrap();
        let Err(error) = setup.source(&policy, 1, Device::Cpu) else {
            panic!("{task} took it");
        };
        let message = error.to_string();
        assert!(
            error.is_bad_input() && message.contains(expected),
            "{message}"
        );
        assert!(
            message.contains(&checkpoint.display().to_string()),
            "{message}"
        );
    }
}

/// The handover seen by a smaller camera, which is drawn sooner.
fn small_handover(policy: &PolicyChoice) -> Setup {
    let mut setup = handover(policy);
    setup.task.shading = Shading::Plain;
    for camera in &mut setup.task.cameras {
        (camera.width, camera.height) = (256, 256);
    }
    setup
}

/// Records one demonstration by `plan`.
fn record_one(plan: Plan, out: &Path) -> Dataset {
    let options = RecordOptions {
        episodes: 1,
        out: out.to_owned(),
        resume: false,
        jobs: 1,
        depth: false,
        video: None,
        disturb: None,
        instruction: None,
        failures: None,
    };
    let plan = Plan { seed: 3, ..plan };
    let summary = record(&plan, &options, &|| false, &mut |_| {}).unwrap();
    assert_eq!((summary.episodes, summary.attempts.len()), (1, 1));
    let dataset = Dataset::open(out).unwrap();
    assert_eq!(dataset.len(), summary.steps);
    dataset
}

/// Both arms move in a demonstration, and each one's commands are near its own tip.
fn check_demonstration(dataset: &Dataset) {
    let place = |numbers: &[f64]| Vector3::new(numbers[0], numbers[1], numbers[2]);
    for arm in 0..2 {
        let start = place(&dataset.tip_pose(0, arm));
        let (mut way_m, mut lead_m) = (0.0_f64, 0.0_f64);
        for frame in 0..dataset.len() {
            let tip = place(&dataset.tip_pose(frame, arm));
            way_m = way_m.max((tip - start).norm());
            lead_m = lead_m.max((place(&dataset.action(frame, arm)) - tip).norm());
        }
        assert!(way_m > 0.01 && lead_m < 0.02, "{arm}: {way_m} {lead_m}");
    }
    let first = dataset.state(0, 0).map(f32::to_bits);
    assert_ne!(first, dataset.state(dataset.len() - 1, 0).map(f32::to_bits));
}

/// Two steps of the small network.
fn training_options(data: PathBuf, out: PathBuf) -> TrainingOptions {
    TrainingOptions {
        network: NetworkChoice::Act,
        data: vec![data],
        out,
        cameras: CameraChoice::Multi,
        preset: "small".to_owned(),
        published: false,
        backbone: BackboneNorm::GroupNorm,
        backbone_weights: None,
        steps: Some(2),
        batch: Some(2),
        device: Device::Cpu,
        bf16: false,
        episodes: None,
        validation_share: 0.0,
        augment: false,
        query_every: None,
        lr: None,
        shift_px: None,
        state_noise: None,
        clouds: None,
        images_on_host: false,
        eager: false,
        threads: 2,
        seed: 1,
        save_every: 0,
        eval: None,
        command: "train".to_owned(),
    }
}

#[test]
fn a_query_interval_longer_than_a_chunk_is_refused() {
    let wants = |query_every| TrainingOptions {
        query_every,
        ..training_options(PathBuf::new(), PathBuf::new())
    };
    assert_eq!(query_every(&wants(None), 25, 50).unwrap(), 25);
    assert_eq!(query_every(&wants(Some(50)), 25, 50).unwrap(), 50);
    let error = query_every(&wants(Some(51)), 25, 50).unwrap_err();
    assert!(error.to_string().contains("--query-every 51"), "{error}");
}

/// A demonstration of two arms trains a network that commands both.
#[test]
fn network_of_two_arms_commands_both() {
    let folder = Scratch::new("session-bimanual");
    let (data, out) = (folder.0.join("data"), folder.0.join("act"));
    let expert = PolicyChoice::Expert;
    let dataset = record_one(Plan::new(small_handover(&expert), expert), &data);
    assert_eq!(dataset.arms(), 2);
    check_demonstration(&dataset);
    let options = training_options(data, out.clone());
    assert!(train(&options, &mut |_| {}).unwrap().loss.is_finite());
    let policy = PolicyChoice::Checkpoint(out);
    let file = Scratch::new("session-bimanual-log");
    let (end, log) = run_setup(&small_handover(&policy), &policy, 2200, &file);
    let policy_did = end.tally.policy();
    assert_eq!((policy_did.queries, end.tally.faults()), (3, None));
    assert!(policy_did.refused < 2, "{policy_did:?}");
    let chunks: Vec<_> = log
        .ticks()
        .filter_map(|(_, chunks)| Some((chunks.first?, chunks.second.flatten()?)))
        .collect();
    assert_eq!(chunks.len(), 3);
    for (index, (first, second)) in (1..).zip(&chunks) {
        assert_eq!((first.sequence, second.sequence), (index, index));
        assert_eq!(first.observed_at, second.observed_at);
        assert_ne!(first.targets, second.targets);
    }
    let replayed = replay(&log).unwrap();
    assert!(
        replayed.identical && replayed.inputs_checked,
        "{replayed:?}"
    );
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations.first());
}
