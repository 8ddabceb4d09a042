//! One answer of an ACT policy: frames of 512x512 in, a chunk out, on one core.

#![expect(
    clippy::expect_used,
    reason = "a bench can't go on without its subject"
)]

mod support;

use std::error::Error;
use std::path::Path;

use criterion::Criterion;
use hal::{
    ArmObservation, ArmState, CameraFrame, Intrinsics, JointVector, Observation, Policy, TimeNs,
};
use tch::Device;
use trocar::rt::MonotonicClock;
use trocar::session::demo::COMMITTED_POLICY;
use trocar::session::source::{NETWORK_LATENCY_TICKS, STEP_NS};
use trocar_control::kinematics::forward;
use trocar_data::relative_action::REPRESENTATION;
use trocar_nets::act::{Act, ActConfig, ActPreset};
use trocar_nets::act_policy::ActPolicy;
use trocar_nets::checkpoint::{
    AggregationName, DatasetSummary, FeatureStatistics, RECIPE_FORMAT, Recipe,
    RecommendedAggregation, RecordedCamera, SaveOptions, Variants, save,
};
use trocar_nets::normalise::Statistics;
use trocar_nets::parameters::ParameterSource;

/// One camera, and as many as `--cameras multi` has with one arm.
const CAMERAS: [&str; 3] = ["endoscope", "wrist_psm1", "side"];
const SIDE_PIXELS: u32 = 512;
const RUNS: u32 = 20;

/// Saves an untrained network of the preset `small` with some cameras, which takes as long as a
/// trained one.
fn save_untrained(folder: &Path, cameras: &[&str]) -> Result<(), Box<dyn Error>> {
    let feature = |camera: &&str| format!("observation.images.{camera}");
    let cameras: Vec<String> = cameras.iter().map(feature).collect();
    let config = ActConfig::preset(ActPreset::Small, &cameras);
    let spread = |std: f32| Statistics {
        mean: vec![0.0; 7],
        std: vec![std; 7],
        min: vec![],
        max: vec![],
    };
    let statistics = FeatureStatistics {
        state: spread(0.5),
        action: spread(0.002),
    };
    let recipe = Recipe {
        format: RECIPE_FORMAT,
        arms: 1,
        action_representation: REPRESENTATION.to_owned(),
        step_ns: STEP_NS,
        query_every_steps: 25,
        aggregation: RecommendedAggregation {
            mode: AggregationName::Ensemble,
            decay: 0.01,
        },
        cameras: cameras
            .into_iter()
            .map(|feature| RecordedCamera {
                feature,
                width: SIDE_PIXELS,
                height: SIDE_PIXELS,
            })
            .collect(),
        preset: ActPreset::Small.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        recipe: "untrained".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1,
        training: serde_json::Value::Null,
    };
    let act = Act::new(config, ParameterSource::seeded(1, Device::Cpu))?;
    let options = SaveOptions {
        inference_only: true,
        ..SaveOptions::default()
    };
    save(folder, &act, &statistics, &recipe, options)?;
    Ok(())
}

/// Frames as the policy wants them, with something in them.
fn frames(policy: &ActPolicy) -> Vec<CameraFrame> {
    let one = |camera: &RecordedCamera| {
        let intrinsics = Intrinsics::from_vertical_fov(camera.width, camera.height, 0.62);
        let mut frame = CameraFrame::blank(intrinsics);
        for (byte, shade) in frame.colour.iter_mut().zip((0..=250_u8).cycle()) {
            *byte = shade;
        }
        frame
    };
    policy.recipe().cameras.iter().map(one).collect()
}

/// Times the policy in `folder`.
fn infer(criterion: &mut Criterion, name: &str, folder: &Path) -> Result<(), Box<dyn Error>> {
    let clock = MonotonicClock::new();
    let mut policy = ActPolicy::load(folder, Device::Cpu)?;
    let frames = frames(&policy);
    let frames: Vec<_> = frames.iter().map(CameraFrame::as_frame).collect();
    let joints = JointVector::new(0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0);
    let arm = ArmObservation {
        state: ArmState::at_rest(TimeNs(0), joints, 0.4),
        tip_in_rcm: forward(&joints),
    };
    let observation = Observation {
        arms: &[arm],
        frames: &frames,
    };
    let times = support::measure(criterion, &format!("inference/{name}"), RUNS, || {
        let before = clock.now();
        let chunks = policy.infer(&observation).expect("it answers");
        let took_ns = clock.now().since(before);
        assert!(
            chunks.iter().all(|chunk| !chunk.valid_targets().is_empty()),
            "the chunks say something"
        );
        took_ns
    });
    let ms = |fraction| TimeNs(times.percentile(fraction)).seconds() * 1e3;
    let figure = format!(
        "ACT {name}, one core: p50 {:.1} ms, worst {:.1} ms of {}",
        ms(0.5),
        ms(1.0),
        times.count()
    );
    let step_ms = TimeNs(STEP_NS).seconds() * 1e3;
    let latency_ms = TimeNs::from_tick(NETWORK_LATENCY_TICKS).seconds() * 1e3;
    let target = format!("within the {latency_ms} ms that lockstep gives it");
    support::report(&figure, &target, latency_ms / ms(0.5));
    let period_ms = step_ms * f64::from(policy.recipe().query_every_steps);
    let target = format!("within the {period_ms} ms after which it is asked again");
    support::report(&figure, &target, period_ms / ms(0.5));
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let untrained = std::env::temp_dir().join(format!("trocar-bench-{}", std::process::id()));
    for (name, cameras) in [
        ("small, untrained", 1),
        ("small, untrained, three cameras", CAMERAS.len()),
    ] {
        save_untrained(&untrained, &CAMERAS[..cameras])?;
        let result = infer(&mut criterion, name, &untrained);
        std::fs::remove_dir_all(&untrained)?;
        result?;
    }
    let committed = tests::repository().join(COMMITTED_POLICY);
    if committed.join("config.json").exists() {
        infer(&mut criterion, "as committed", &committed)?;
    }
    criterion.final_summary();
    Ok(())
}
