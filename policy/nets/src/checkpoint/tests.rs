//! What is saved comes back, and what is damaged is refused by name.

mod refused;
mod two_arms;

use std::fs;
use std::path::{Path, PathBuf};

use hal::{
    ArmObservation, ArmState, CameraFrame, Intrinsics, JointVector, Observation, Policy,
    PolicyError, Pose, TimeNs,
};
use tch::Device;

use super::{
    AggregationName, Cause, CheckpointError, DatasetSummary, FeatureStatistics, Precision, Recipe,
    RecommendedAggregation, RecordedCamera, SaveOptions, Variants, load, save,
};
use crate::act::{Act, ActConfig, ActPreset, BackboneNorm};
use crate::act_policy::ActPolicy;
use crate::normalise::Statistics;
use crate::parameters::ParameterSource;

const CAMERA: &str = "observation.images.endoscope";

pub(super) fn folder(name: &str) -> PathBuf {
    let folder =
        std::env::temp_dir().join(format!("trocar-checkpoint-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

pub(super) fn config() -> ActConfig {
    let base = ActConfig::preset(ActPreset::Small, &[CAMERA.to_owned()]);
    ActConfig {
        chunk_size: 5,
        dim_model: 32,
        n_heads: 4,
        dim_feedforward: 64,
        n_encoder_layers: 1,
        n_vae_encoder_layers: 1,
        image_height: 64,
        image_width: 64,
        ..base
    }
}

pub(super) fn statistics() -> FeatureStatistics {
    let of = |scale: f32| Statistics {
        mean: vec![0.1 * scale; 7],
        std: vec![scale; 7],
        min: vec![],
        max: vec![],
    };
    FeatureStatistics {
        state: of(0.5),
        action: of(0.002),
    }
}

/// An arm at rest at `jaw`, 10 cm down.
pub(super) fn arm(jaw: f64) -> ArmObservation {
    ArmObservation {
        state: ArmState::at_rest(TimeNs(7), JointVector::zeros(), jaw),
        tip_in_rcm: Pose::translation(0.0, 0.0, -0.1),
    }
}

pub(super) fn recipe(config: &ActConfig) -> Recipe {
    Recipe {
        format: super::RECIPE_FORMAT,
        arms: 1,
        action_representation: trocar_data::relative_action::REPRESENTATION.to_owned(),
        step_ns: 40_000_000,
        query_every_steps: 5,
        aggregation: RecommendedAggregation {
            mode: AggregationName::WholeChunk,
            decay: 0.0,
        },
        cameras: vec![RecordedCamera {
            feature: CAMERA.to_owned(),
            width: 128,
            height: 128,
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

pub(super) fn saved(name: &str, options: SaveOptions) -> PathBuf {
    saved_network(name, &config(), options)
}

fn saved_network(name: &str, config: &ActConfig, options: SaveOptions) -> PathBuf {
    let folder = folder(name);
    let act = Act::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap();
    save(&folder, &act, &statistics(), &recipe(config), options).unwrap();
    folder
}

pub(super) fn refused(folder: &Path) -> CheckpointError {
    load(folder, Device::Cpu).expect_err("the damage must be noticed")
}

pub(super) fn edit(folder: &Path, file: &str, from: &str, to: &str) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{file} has no {from}");
    fs::write(&path, text.replace(from, to)).unwrap();
}

pub(super) fn frame() -> CameraFrame {
    let mut frame = CameraFrame::blank(Intrinsics::from_vertical_fov(128, 128, 1.0));
    for (index, byte) in frame.colour.iter_mut().enumerate() {
        *byte = u8::try_from(index * 7 % 251).unwrap();
    }
    frame
}

#[test]
fn a_policy_answers_the_same_after_a_second_loading() {
    let folder = saved("again", SaveOptions::default());
    let frame = frame();
    let frames = [frame.as_frame()];
    let observation = Observation {
        arms: &[arm(0.2)],
        frames: &frames,
    };
    let answer = || {
        let mut policy = ActPolicy::load(&folder, Device::Cpu).unwrap();
        let [chunk] = policy.infer(&observation).unwrap()[..] else {
            panic!("one arm, one chunk");
        };
        chunk
    };
    let (first, second) = (answer(), answer());
    assert_eq!(first, second);
    assert_eq!(
        (first.len, first.step_ns, first.observed_at),
        (5, 40_000_000, TimeNs(7))
    );
    // The mean action is 0.2 mm and the deviation 2 mm, so targets stay near the tip.
    assert!(
        first
            .valid_targets()
            .iter()
            .all(|target| (target.position_m[2] + 0.1).abs() < 0.05)
    );
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn half_precision_without_the_variational_encoder_is_close() {
    let full = load(&saved("full", SaveOptions::default()), Device::Cpu).unwrap();
    let options = SaveOptions {
        precision: Precision::F16,
        inference_only: true,
    };
    let half_folder = saved("half", options);
    let half = load(&half_folder, Device::Cpu).unwrap();
    assert!(
        half.act
            .parameters()
            .iter()
            .all(|(key, _)| !key.contains("vae"))
    );
    let images = tch::Tensor::ones([1, 1, 3, 64, 64], (tch::Kind::Float, Device::Cpu));
    let state = tch::Tensor::ones([1, 7], (tch::Kind::Float, Device::Cpu));
    let difference =
        full.act.infer(&images, &state).unwrap() - half.act.infer(&images, &state).unwrap();
    let worst = difference.abs().max().double_value(&[]);
    assert!(worst > 0.0 && worst < 0.01, "{worst}");
}

/// A backbone that LeRobot lacks has a name that LeRobot refuses.
#[test]
fn group_norm_backbone_has_a_name_lerobot_refuses() {
    let folder = saved("backbone", SaveOptions::default());
    let name = |folder: &Path| {
        let text = fs::read(folder.join("config.json")).unwrap();
        let config: serde_json::Value = serde_json::from_slice(&text).unwrap();
        config["vision_backbone"].as_str().unwrap().to_owned()
    };
    assert!(!name(&folder).starts_with("resnet"));
    // The name alone says it, and a recipe of before the name was there says it as well.
    let norm = |folder: &Path| {
        load(folder, Device::Cpu)
            .unwrap()
            .act
            .config()
            .backbone_norm
    };
    fs::rename(folder.join("trocar.json"), folder.join("aside")).unwrap();
    assert_eq!(norm(&folder), BackboneNorm::GroupNorm);
    fs::rename(folder.join("aside"), folder.join("trocar.json")).unwrap();
    edit(&folder, "config.json", "group_norm_resnet18", "resnet18");
    assert_eq!(norm(&folder), BackboneNorm::GroupNorm);

    let folder = saved("backbone", SaveOptions::default());
    edit(&folder, "trocar.json", "group_norm", "frozen_batch_norm");
    let message = refused(&folder).to_string();
    assert!(message.contains("backbone_norm is another"), "{message}");
}

#[test]
fn fewer_stages_come_back_and_impossible_numbers_are_refused() {
    let config = ActConfig {
        backbone_stages: 3,
        ..config()
    };
    let folder = saved_network("stages", &config, SaveOptions::default());
    let loaded = load(&folder, Device::Cpu).unwrap();
    let read = loaded.act.config();
    assert_eq!(
        (read.backbone_stages, read.backbone_norm),
        (3, config.backbone_norm)
    );
    let mut before = "_stages3".to_owned();
    for number in ["0", "9", "X", "-1"] {
        let now = format!("_stages{number}");
        edit(&folder, "config.json", &before, &now);
        let message = refused(&folder).to_string();
        assert!(
            message.contains("vision_backbone") && message.contains(&now),
            "{message}"
        );
        before = now;
    }
    // All stages want weights that are not there.
    edit(&folder, "config.json", &before, "");
    let message = refused(&folder).to_string();
    assert!(message.contains("layer4"), "{message}");
}
