//! A tiny DP3 learns a tiny dataset with depth, the same way every time, and survives the disk as a
//! policy.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::PoisonError;

use hal::{
    ArmObservation, ArmState, CameraFrame, FrameRef, Intrinsics, JointVector, Observation, Policy,
    Pose, TimeNs,
};
use tch::{Device, Kind};

use super::tests::ONE_AT_A_TIME;
use super::{Progress, Schedule, TrainError, TrainOptions, TrainPrecision, Trained, Trainer};
use trocar_data::dataset::{
    ArmFrame, CameraSpec, Dataset, DatasetSpec, DatasetWriter, DepthFrame, FrameRecord,
};
use trocar_data::perception::{CloudFrame, CloudRecipe, Padding, depth_from_units};
use trocar_nets::checkpoint::{
    self, AggregationName, DatasetSummary, Precision, Recipe, RecommendedAggregation,
    RecordedCamera, Variants,
};
use trocar_nets::dp3::{Dp3, Dp3Config, Dp3Preset};
use trocar_nets::dp3_policy::Dp3Policy;

const SIDE: u32 = 16;
const PIXELS: usize = (SIDE * SIDE) as usize;
const STEP_NS: u64 = 40_000_000;

pub(super) fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("trocar-dp3-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

pub(super) fn lens() -> Intrinsics {
    Intrinsics::from_vertical_fov(SIDE, SIDE, 0.8)
}

/// A step before a far wall, of instance 2 and 1; it is nearer the later it is.
fn scene(step: u16) -> (Vec<u16>, Vec<u8>) {
    let shown = |place: usize| (place % 16 + place / 16).is_multiple_of(3);
    let depth = |place| if shown(place) { 5000 + 40 * step } else { 9000 };
    let id = |place| if shown(place) { 2 } else { 1 };
    (
        (0..PIXELS).map(depth).collect(),
        (0..PIXELS).map(id).collect(),
    )
}

/// Two episodes; the tip moves towards the camera.
pub(super) fn dataset(name: &str, depth: Option<Intrinsics>) -> (PathBuf, Dataset) {
    dataset_hiding(name, depth, |_| false)
}

/// The same, but in the frames of which `hidden` says so nothing is in view but the wall.
fn dataset_hiding(
    name: &str,
    depth: Option<Intrinsics>,
    hidden: impl Fn(u16) -> bool,
) -> (PathBuf, Dataset) {
    let folder = folder(name);
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms: 1,
        task: "follow the step".to_owned(),
        cameras: vec![CameraSpec {
            name: "endoscope".to_owned(),
            width: SIDE,
            height: SIDE,
            depth,
        }],
        intervention: false,
    };
    let mut writer = DatasetWriter::create(&folder, &spec).unwrap();
    for episode in 0..2_u16 {
        for step in 0..6_u16 {
            let along = 0.001 * f64::from(step);
            let (units, mut instance) = scene(step + episode);
            if hidden(6 * episode + step) {
                instance.fill(1);
            }
            let depth_frame = DepthFrame {
                units: &units,
                instance: &instance,
                camera_in_scene: [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0],
            };
            let all = [depth_frame];
            let kept = if depth.is_some() { &all[..] } else { &[] };
            writer
                .push_frame(&FrameRecord {
                    arms: &[ArmFrame {
                        state: [0.01 * f32::from(step); 7],
                        tip_pose: [along, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0],
                        action: [along + 0.001, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0, 0.5],
                    }],
                    images: &[&vec![7; 3 * PIXELS]],
                    depth: kept,
                })
                .unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
    let dataset = Dataset::open(&folder).unwrap();
    (folder, dataset)
}

pub(super) fn config() -> Dp3Config {
    Dp3Config {
        horizon: 8,
        n_action_steps: 4,
        down_dims: vec![16, 32],
        ..Dp3Config::preset(Dp3Preset::Simple, 7, 7)
    }
}

pub(super) fn cloud() -> CloudRecipe {
    CloudRecipe {
        frame: CloudFrame::Scene,
        crop_m: Some([[-1.0; 3], [1.0; 3]]),
        dropped_instances: vec![0, 1],
        voxel_m: None,
        points: 32,
        padding: Padding::FirstPoint,
    }
}

pub(super) fn options() -> TrainOptions {
    TrainOptions {
        batch: 12,
        lr: 3e-3,
        schedule: Schedule::Constant,
        warm_up_steps: 2,
        log_every: 10,
        threads: 1,
        ..TrainOptions::dp3(60)
    }
}

fn train(dataset: &Dataset, options: &TrainOptions) -> Result<Trained<Dp3>, TrainError> {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    Trainer::new(Device::Cpu).run_dp3(
        &config(),
        &cloud(),
        options,
        dataset,
        &mut |_: &Progress| (),
    )
}

pub(super) fn recipe() -> Recipe {
    Recipe {
        format: checkpoint::RECIPE_FORMAT,
        arms: 1,
        action_representation: trocar_data::relative_action::REPRESENTATION.to_owned(),
        step_ns: STEP_NS,
        query_every_steps: 4,
        aggregation: RecommendedAggregation {
            mode: AggregationName::Newest,
            decay: 0.01,
        },
        cameras: vec![RecordedCamera {
            feature: "observation.images.endoscope".to_owned(),
            width: SIDE,
            height: SIDE,
        }],
        preset: Dp3Preset::Simple.into(),
        variants: Variants::default(),
        recipe: "test".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1,
        training: serde_json::Value::Null,
    }
}

fn save(folder: &Path, trained: &Trained<Dp3>, step_ns: u64) {
    let recipe = Recipe {
        step_ns,
        ..recipe()
    };
    let (dp3, statistics) = (&trained.network, &trained.statistics);
    checkpoint::save_dp3(folder, dp3, &cloud(), statistics, &recipe, Precision::F32).unwrap();
}

/// What the policy sees at a step.
pub(super) fn seen(step: u16) -> (ArmObservation, CameraFrame) {
    let (units, instance) = scene(step);
    let mut frame = CameraFrame::blank(lens());
    frame.depth_m = units.into_iter().map(depth_from_units).collect();
    frame.instance = instance;
    let arm = ArmObservation {
        state: ArmState::at_rest(
            TimeNs(u64::from(step) * STEP_NS),
            JointVector::zeros(),
            0.01 * f64::from(step),
        ),
        tip_in_rcm: Pose::translation(0.0, 0.0, -0.1),
    };
    (arm, frame)
}

/// The answer's positions at step 4, of a policy that was shown the steps `shown` before.
fn answer(policy: &mut Dp3Policy, shown: &[u16]) -> Vec<[f64; 3]> {
    for &step in shown {
        let (arm, frame) = seen(step);
        let frames = [frame.as_frame()];
        let (arms, frames) = (&[arm][..], &frames[..]);
        policy.observe(&Observation { arms, frames }).unwrap();
    }
    let (arm, frame) = seen(4);
    let frames: [FrameRef<'_>; 1] = [frame.as_frame()];
    let (arms, frames) = (&[arm][..], &frames[..]);
    let chunks = policy.infer(&Observation { arms, frames }).unwrap();
    let targets = chunks[0].valid_targets();
    targets.iter().map(|target| target.position_m).collect()
}

/// What it trained survives the disk.
#[test]
fn training_lowers_the_loss_and_repeats_itself() {
    let (data, dataset) = dataset("learns", Some(lens()));
    let first = train(&dataset, &options()).unwrap();
    let (start, end) = (first.curve.rows[0], *first.curve.last().unwrap());
    assert!(end.loss < 0.5 * start.loss, "{start:?} {end:?}");
    let short = TrainOptions {
        steps: 10,
        ..options()
    };
    let again = train(&dataset, &short).unwrap();
    assert_eq!(first.curve.rows[0], again.curve.rows[0]);
    let other = train(&dataset, &TrainOptions { seed: 7, ..short }).unwrap();
    assert_ne!(first.curve.rows[0], other.curve.rows[0]);

    let folder = folder("disk");
    save(&folder, &first, STEP_NS);
    let loaded = checkpoint::load_dp3(&folder, Device::Cpu).unwrap();
    assert_eq!(loaded.cloud, cloud());
    for (key, tensor) in first.network.parameters().iter() {
        assert_eq!(loaded.dp3.parameters().get(key), Some(tensor), "{key}");
    }
    let mut policy = Dp3Policy::load(&folder, Device::Cpu).unwrap();
    let mut fresh = |seed, shown: &[u16]| {
        policy.reset(seed);
        answer(&mut policy, shown)
    };
    let both = fresh(3, &[3]);
    assert_eq!(both.len(), 7, "what is left of the horizon");
    assert_eq!(both, fresh(3, &[3]), "same seed, same answer");
    assert_ne!(both, fresh(4, &[3]), "the noise is the seed's");
    assert_ne!(both, fresh(3, &[]), "the step before is seen");
    assert_eq!(both, fresh(3, &[0, 1, 2, 3]), "older steps are not");
    assert_eq!(fresh(3, &[]), fresh(3, &[1]), "a gap is no history");

    // Of 15 steps a second the one before is 67 ms ago: nearest to it is what was seen 80 ms ago,
    // in a run that shows it every 40.
    save(&folder, &first, 66_666_667);
    let mut slow = Dp3Policy::load(&folder, Device::Cpu).unwrap();
    assert_eq!((policy.history_steps(), slow.history_steps()), (1, 2));
    let mut fresh = |shown: &[u16]| {
        slow.reset(3);
        answer(&mut slow, shown)
    };
    assert_eq!(fresh(&[2, 3]), fresh(&[2]));
    assert_ne!(fresh(&[2, 3]), fresh(&[3]));
    assert_eq!(fresh(&[1]), fresh(&[]));
    fs::remove_dir_all(&folder).unwrap();
    fs::remove_dir_all(&data).unwrap();
}

#[test]
fn sixteen_bits_learn_as_thirty_two_do() {
    let (data, dataset) = dataset("bf16", Some(lens()));
    let losses = [TrainPrecision::F32, TrainPrecision::Bf16].map(|precision| {
        let trained = train(
            &dataset,
            &TrainOptions {
                precision,
                ..options()
            },
        )
        .unwrap();
        // What is kept has single precision.
        let parameters = trained.network.parameters();
        assert!(
            parameters
                .iter()
                .all(|(_, tensor)| tensor.kind() == Kind::Float)
        );
        let rows = trained.curve.rows;
        (rows[0].loss, rows[rows.len() - 1].loss)
    });
    let [(start, end), (start_16, end_16)] = losses;
    let apart = (start_16 - start).abs();
    assert!(apart > 0.0 && apart < 0.02 * start, "{losses:?}");
    assert!(end_16 < 0.5 * start_16 && end_16 < 1.5 * end, "{losses:?}");
    fs::remove_dir_all(&data).unwrap();
}

#[test]
fn missing_depth_and_damaged_files_are_refused() {
    let (plain_folder, plain) = dataset("plain", None);
    let error = train(&plain, &options()).unwrap_err().to_string();
    assert!(error.contains("no observation.depth.endoscope"), "{error}");
    fs::remove_dir_all(&plain_folder).unwrap();

    let (data, dataset) = dataset("refusals", Some(lens()));
    let short = TrainOptions {
        steps: 2,
        ..options()
    };
    let trained = train(&dataset, &short).unwrap();
    let folder = folder("frames");
    save(&folder, &trained, STEP_NS);
    let mut policy = Dp3Policy::load(&folder, Device::Cpu).unwrap();
    let (arm, mut frame) = seen(0);
    let mut infer = |frame: &CameraFrame, count: usize| {
        let frames = vec![frame.as_frame(); count];
        let (arms, frames) = (&[arm][..], &frames[..]);
        let error = policy.infer(&Observation { arms, frames }).unwrap_err();
        error.to_string()
    };
    assert!(infer(&frame, 2).contains("1 camera frames"));
    frame.depth_m.fill(0.0);
    let error = infer(&frame, 1);
    assert!(error.contains("0 of these have a depth"), "{error}");
    frame.depth_m.clear();
    let error = infer(&frame, 1);
    assert!(error.contains("depth has 0 pixels"), "{error}");
    let error = trocar_nets::act_policy::ActPolicy::load(&folder, Device::Cpu).unwrap_err();
    assert!(error.to_string().contains("config.json"), "{error}");
    fs::write(folder.join("statistics.safetensors"), b"cut").unwrap();
    let error = Dp3Policy::load(&folder, Device::Cpu).unwrap_err();
    assert!(
        error.to_string().contains("statistics.safetensors"),
        "{error}"
    );
    fs::remove_dir_all(&folder).unwrap();
    fs::remove_dir_all(&data).unwrap();
}

/// What is hidden for a while is trained on and answered; a camera that sees nothing is refused.
#[test]
fn short_occlusion_is_trained_on_and_blindness_refused() {
    let (data, dataset) = dataset_hiding("hidden", Some(lens()), |frame| frame % 6 == 3);
    let short = TrainOptions {
        steps: 10,
        ..options()
    };
    let mut unseen = None;
    let trained = {
        let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let mut hear = |progress: &Progress| {
            if let Progress::Unseen { frames, of } = progress {
                unseen = Some((*frames, *of));
            }
        };
        let trainer = Trainer::new(Device::Cpu);
        let trained = trainer.run_dp3(&config(), &cloud(), &short, &dataset, &mut hear);
        trained.unwrap()
    };
    assert_eq!(unseen, Some((2, 12)));
    assert!(trained.curve.last().unwrap().loss.is_finite());
    // The hidden frames' clouds at the scene's origin are no limit of what there is to see, 0.1 m
    // and more above it.
    assert!(
        trained.statistics.points[0][2] > 0.05,
        "{:?}",
        trained.statistics.points
    );

    let folder = folder("hidden-policy");
    save(&folder, &trained, STEP_NS);
    let mut policy = Dp3Policy::load(&folder, Device::Cpu).unwrap();
    let (arm, mut frame) = seen(0);
    frame.instance.fill(1);
    let frames = [frame.as_frame()];
    let (arms, frames) = (&[arm][..], &frames[..]);
    let chunks = policy.infer(&Observation { arms, frames }).unwrap();
    assert!(!chunks[0].valid_targets().is_empty());
    fs::remove_dir_all(&folder).unwrap();
    fs::remove_dir_all(&data).unwrap();

    let (data, dataset) = dataset_hiding("blind", Some(lens()), |frame| frame % 6 > 3);
    let error = train(&dataset, &short).unwrap_err().to_string();
    assert!(
        error.contains("in 4 of its 12 frames (the first is frame 4) endoscope show nothing"),
        "{error}"
    );
    fs::remove_dir_all(&data).unwrap();
}
