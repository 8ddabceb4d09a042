//! A tiny network learns a tiny dataset, the same way every time, and survives the disk.

use std::fs;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use tch::{Device, Kind, Tensor};

use super::{Progress, Schedule, TrainError, TrainOptions, Trained, Trainer};
use trocar_data::dataset::{
    ArmFrame, CameraSpec, Dataset, DatasetSpec, DatasetWriter, FrameRecord,
};
use trocar_nets::act::{Act, ActConfig, ActPreset};
use trocar_nets::checkpoint::{
    self, AggregationName, DatasetSummary, Recipe, RecommendedAggregation, RecordedCamera,
    SaveOptions, Variants,
};

const SIDE: u32 = 64;

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("trocar-train-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

/// A dataset whose folder goes with it.
pub(super) struct Scratch {
    pub(super) folder: PathBuf,
    pub(super) dataset: Dataset,
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Two episodes in which the tip follows a bright square across the image.
pub(super) fn dataset(name: &str) -> Scratch {
    dataset_of(1, name)
}

/// The same with so many arms; the second goes the other way.
fn dataset_of(arms: usize, name: &str) -> Scratch {
    dataset_seen_by(&["endoscope"], arms, name)
}

/// The same with so many cameras, of which only the first sees the square.
fn dataset_seen_by(cameras: &[&str], arms: usize, name: &str) -> Scratch {
    let folder = folder(name);
    let camera = |name: &&str| CameraSpec {
        name: (*name).to_owned(),
        width: SIDE,
        height: SIDE,
        depth: None,
    };
    let spec = DatasetSpec {
        fps: 25,
        robot_type: "psm".to_owned(),
        arms,
        task: "follow the square".to_owned(),
        cameras: cameras.iter().map(camera).collect(),
        intervention: false,
    };
    let dark = vec![20_u8; 3 * (SIDE * SIDE) as usize];
    let mut writer = DatasetWriter::create(&folder, &spec).unwrap();
    for episode in 0..2_u8 {
        for step in 0..6_u8 {
            let column = usize::from(8 * step + 4 * episode);
            let image: Vec<u8> = (0..(SIDE * SIDE) as usize)
                .flat_map(|pixel| {
                    let lit = (pixel % SIDE as usize).abs_diff(column) < 6;
                    if lit { [250, 200, 150] } else { [30, 20, 10] }
                })
                .collect();
            let along = 0.001 * f64::from(step);
            let aside = 0.0005 * f64::from(episode);
            let of_arm = |sign: f64| ArmFrame {
                state: [0.01 * f32::from(step); 7],
                tip_pose: [sign * along, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0],
                action: [sign * (along + 0.001), aside, -0.1, 0.0, 0.0, 0.0, 1.0, 0.5],
            };
            let both = [of_arm(1.0), of_arm(-1.0)];
            let mut images = vec![&dark[..]; cameras.len()];
            images[0] = &image;
            let record = FrameRecord {
                arms: &both[..arms],
                images: &images,
                depth: &[],
            };
            writer.push_frame(&record).unwrap();
        }
        writer.end_episode().unwrap();
    }
    writer.finish().unwrap();
    let dataset = Dataset::open(&folder).unwrap();
    Scratch { folder, dataset }
}

pub(super) fn config() -> ActConfig {
    let base = ActConfig::preset(
        ActPreset::Small,
        &["observation.images.endoscope".to_owned()],
    );
    ActConfig {
        chunk_size: 4,
        dim_model: 32,
        n_heads: 4,
        dim_feedforward: 64,
        n_encoder_layers: 1,
        n_vae_encoder_layers: 1,
        image_height: 32,
        image_width: 32,
        ..base
    }
}

pub(super) fn options() -> TrainOptions {
    TrainOptions {
        steps: 16,
        schedule: Schedule::Constant,
        batch: 6,
        lr: 1e-3,
        lr_backbone: 1e-3,
        warm_up_steps: 2,
        log_every: 4,
        ema_decay: 0.5,
        threads: 1,
        ..TrainOptions::preset(ActPreset::Small)
    }
}

/// What a checkpoint says of a network that was trained on the tiny dataset.
pub(super) fn recipe(config: &ActConfig) -> Recipe {
    Recipe {
        format: checkpoint::RECIPE_FORMAT,
        arms: 1,
        action_representation: trocar_data::relative_action::REPRESENTATION.to_owned(),
        step_ns: 40_000_000,
        query_every_steps: 4,
        aggregation: RecommendedAggregation {
            mode: AggregationName::Ensemble,
            decay: 0.01,
        },
        cameras: vec![RecordedCamera {
            feature: config.cameras[0].clone(),
            width: SIDE,
            height: SIDE,
        }],
        preset: ActPreset::Small.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        recipe: "test".to_owned(),
        dataset: DatasetSummary::default(),
        seed: 1,
        training: serde_json::Value::Null,
    }
}

/// The library's number of threads belongs to the process, and its answers' last bits hang on it:
/// one training at a time.
pub(super) static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn run(
    config: &ActConfig,
    scratch: &Scratch,
    options: &TrainOptions,
) -> Result<Trained<Act>, TrainError> {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    Trainer::new(Device::Cpu).run(config, options, &scratch.dataset, &mut |_: &Progress| ())
}

fn train(scratch: &Scratch, options: &TrainOptions) -> Result<Trained<Act>, TrainError> {
    run(&config(), scratch, options)
}

fn answer(act: &Act) -> Vec<f32> {
    let images = Tensor::ones([1, 1, 3, 32, 32], (Kind::Float, Device::Cpu));
    let state = Tensor::ones([1, 7], (Kind::Float, Device::Cpu));
    let chunk = tch::no_grad(|| act.infer(&images, &state)).unwrap();
    Vec::<f32>::try_from(chunk.flatten(0, -1)).unwrap()
}

/// What it trained survives the disk.
#[test]
fn training_lowers_the_loss_and_repeats_itself() {
    let dataset = dataset("learns");
    let first = train(&dataset, &options()).unwrap();
    let (start, end) = (first.curve.rows[0], *first.curve.last().unwrap());
    assert!(
        end.loss < 0.5 * start.loss && end.l1 < 0.9 * start.l1,
        "{start:?} {end:?}"
    );
    assert_eq!(
        (end.step, first.curve.rows.len(), first.frames),
        (16, 4, 12)
    );

    let again = train(
        &dataset,
        &TrainOptions {
            steps: 4,
            ..options()
        },
    )
    .unwrap();
    assert_eq!(first.curve.rows[0], again.curve.rows[0]);
    let other = train(
        &dataset,
        &TrainOptions {
            seed: 7,
            steps: 4,
            ..options()
        },
    )
    .unwrap();
    assert_ne!(first.curve.rows[0], other.curve.rows[0]);

    let folder = folder("disk");
    checkpoint::save(
        &folder,
        &first.network,
        &first.statistics,
        &recipe(&config()),
        SaveOptions::default(),
    )
    .unwrap();
    let loaded = checkpoint::load(&folder, Device::Cpu).unwrap();
    assert_eq!(answer(&first.network), answer(&loaded.act));
    assert_eq!(first.statistics, loaded.statistics);
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn images_on_host_or_device_train_the_same() {
    let dataset = dataset_seen_by(&["wrist", "endoscope"], 1, "cameras");
    let cameras = ["wrist", "endoscope"].map(|name| format!("observation.images.{name}"));
    let config = ActConfig {
        cameras: cameras.to_vec(),
        ..config()
    };
    let resident = run(&config, &dataset, &options()).unwrap();
    let (start, end) = (resident.curve.rows[0], *resident.curve.last().unwrap());
    assert!(end.l1 < 0.9 * start.l1, "{start:?} {end:?}");
    let streamed = TrainOptions {
        images_on_host: true,
        ..options()
    };
    let _one = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let mut read = Vec::new();
    let trainer = Trainer::new(Device::Cpu);
    let streamed = trainer
        .run(
            &config,
            &streamed,
            &dataset.dataset,
            &mut |progress: &Progress| {
                if let Progress::Read { frames, of } = progress {
                    read.push((*frames, *of));
                }
            },
        )
        .unwrap();
    assert_eq!(read, [(12, 12)]);
    assert_eq!(resident.curve, streamed.curve);
}

#[test]
fn a_held_out_episode_is_validated_and_not_trained_on() {
    let dataset = dataset("held-out");
    let trained = train(
        &dataset,
        &TrainOptions {
            validation_share: 0.5,
            steps: 2,
            ..options()
        },
    )
    .unwrap();
    assert_eq!(trained.frames, 6);
    assert!(trained.curve.last().unwrap().validation_l1.unwrap() > 0.0);
}

#[test]
fn relative_actions_are_those_of_the_recording() {
    let trained = train(
        &dataset("statistics"),
        &TrainOptions {
            steps: 1,
            ..options()
        },
    )
    .unwrap();
    let action = &trained.statistics.action;
    // From one to four steps ahead of the tip, padding not counted, half a millimetre aside in the
    // second episode.
    assert!(
        (action.min[0] - 0.001).abs() < 1e-6 && (action.max[0] - 0.004).abs() < 1e-6,
        "{action:?}"
    );
    assert!((action.mean[1] - 0.000_25).abs() < 1e-6, "{action:?}");
    assert!(
        (action.mean[6] - 0.5).abs() < 1e-6 && action.std[6] > 1e-3,
        "{action:?}"
    );
}

#[test]
fn two_arms_are_learned_each_relative_to_its_own_tip() {
    let dataset = dataset_of(2, "two-arms");
    let trained = run(&config().for_arms(2), &dataset, &options()).unwrap();
    let (start, end) = (trained.curve.rows[0], *trained.curve.last().unwrap());
    assert!(end.l1 < 0.9 * start.l1, "{start:?} {end:?}");
    let action = &trained.statistics.action;
    assert_eq!(
        (action.mean.len(), trained.statistics.state.std.len()),
        (14, 14)
    );
    // One to four steps ahead of its own tip, in its own direction.
    for (dim, least, greatest) in [(0, 0.001, 0.004), (7, -0.004, -0.001)] {
        assert!((action.min[dim] - least).abs() < 1e-6, "{action:?}");
        assert!((action.max[dim] - greatest).abs() < 1e-6, "{action:?}");
    }
    assert!((action.mean[8] - 0.000_25).abs() < 1e-6, "{action:?}");

    let error = run(&config(), &dataset, &options()).unwrap_err();
    assert!(error.to_string().contains("it has 2 arms"), "{error}");
}

#[test]
fn divergence_and_foreign_cameras_are_errors() {
    let dataset = dataset("diverges");
    let overflowing = ActConfig {
        kl_weight: 1e38,
        ..config()
    };
    let error = run(&overflowing, &dataset, &options()).unwrap_err();
    assert!(
        matches!(
            error,
            TrainError::Diverged {
                step: 1,
                term: "loss",
                ..
            }
        ),
        "{error}"
    );
    let impossible = TrainOptions {
        lr: f64::NAN,
        ..options()
    };
    assert!(matches!(
        train(&dataset, &impossible).unwrap_err(),
        TrainError::Options(_)
    ));
    let foreign = ActConfig {
        cameras: vec!["observation.images.wrist".to_owned()],
        ..config()
    };
    let error = run(&foreign, &dataset, &options()).unwrap_err();
    assert!(
        error.to_string().contains("endoscope") && error.to_string().contains("wrist"),
        "{error}"
    );
}
