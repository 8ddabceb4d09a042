//! Policies that see point clouds: recorded, trained, run in lockstep.

use super::*;
use crate::session::training::TrainingResult;
use crate::session::{SessionError, tensorboard};

/// Sides of the camera's images, pixels.
const SIDE: u32 = 128;

fn small_lift(policy: &PolicyChoice, side: u32) -> Setup {
    let mut setup = Setup::load("needle-lift", None, policy).unwrap();
    setup.task.shading = Shading::Plain;
    for camera in &mut setup.task.cameras {
        (camera.width, camera.height) = (side, side);
    }
    setup
}

pub(super) fn record_lift(out: &Path, depth: bool, side: u32) -> Dataset {
    let options = RecordOptions {
        episodes: 1,
        out: out.to_owned(),
        resume: false,
        jobs: 1,
        depth,
        video: None,
        disturb: None,
        instruction: None,
        failures: None,
    };
    let expert = PolicyChoice::Expert;
    let plan = Plan {
        seed: 3,
        ..Plan::new(small_lift(&expert, side), expert)
    };
    record(&plan, &options, &|| false, &mut |_| {}).unwrap();
    Dataset::open(out).unwrap()
}

fn train_simple(data: &Path, out: &Path) -> Result<TrainingResult, SessionError> {
    let options = TrainingOptions {
        network: NetworkChoice::Dp3,
        preset: "simple".to_owned(),
        ..super::training_options(data.to_owned(), out.to_owned())
    };
    train(&options, &mut |_| {})
}

/// A demonstration with depth trains a diffusion policy that repeats itself.
#[test]
fn diffusion_policy_from_depth_repeats_itself() {
    let folder = Scratch::new("session-clouds");
    let (data, out) = (folder.0.join("data"), folder.0.join("dp3"));
    let dataset = record_lift(&data, true, SIDE);
    let seen = dataset.depth(0, 0).unwrap();
    assert!(seen.units.iter().any(|&units| units > 0));
    assert!(
        [2, 4, 5].iter().all(|id| seen.instance.contains(id)),
        "needle, wrist and jaw"
    );
    let loss = train_simple(&data, &out).unwrap().loss;
    assert!(loss.is_finite());
    let scalars = tensorboard::tests::scalars(&out);
    let [(step, value)] = scalars["train/loss"][..] else {
        panic!("{scalars:?}");
    };
    assert_eq!(step, 2);
    assert!((f64::from(value) - loss).abs() < 1e-6 * loss, "{value}");
    let rate = scalars["train/samples_per_second"][0].1;
    assert!(rate > 0.0, "{rate}");

    let policy = PolicyChoice::Checkpoint(out);
    let mut hashes = Vec::new();
    for run in 0..2 {
        let file = Scratch::new(&format!("session-clouds-{run}"));
        let (end, log) = run_setup(&small_lift(&policy, SIDE), &policy, 1500, &file);
        assert_eq!(end.tally.faults(), None);
        hashes.push(end.tally.command_hash());
        let chunks: Vec<_> = log.ticks().filter_map(|(_, chunks)| chunks.first).collect();
        // Every eight steps of 40 ms, 160 ms late; all that is left of the horizon.
        let observed: Vec<u64> = chunks.iter().map(|chunk| chunk.observed_at.0).collect();
        assert_eq!(observed, [0, 320, 640, 960, 1280].map(|ms| ms * 1_000_000));
        assert!(chunks.iter().all(|chunk| chunk.len == 15));
        let replayed = replay(&log).unwrap();
        assert!(replayed.identical, "{replayed:?}");
    }
    assert_eq!(hashes[0], hashes[1]);
}

#[test]
fn a_recording_without_depth_is_refused_with_what_to_do() {
    let folder = Scratch::new("session-no-depth");
    let (data, out) = (folder.0.join("data"), folder.0.join("dp3"));
    record_lift(&data, false, SIDE);
    let error = train_simple(&data, &out).unwrap_err();
    assert!(error.is_bad_input());
    assert!(error.to_string().contains("record with --depth"), "{error}");
}
