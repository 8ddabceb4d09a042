//! Folded and trained networks give the same answers, to rounding.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::FoldedAct;
use crate::act::{Act, ActConfig, BackboneNorm};
use crate::parameters::ParameterSource;
use crate::rng::SplitMix64;

/// Of the greatest number in a chunk.
const ROUNDING: f64 = 3e-6;

fn config(norm: BackboneNorm, cameras: usize) -> ActConfig {
    let names: Vec<String> = (0..cameras)
        .map(|index| format!("observation.images.{index}"))
        .collect();
    ActConfig {
        chunk_size: 6,
        dim_model: 32,
        n_heads: 4,
        dim_feedforward: 48,
        n_encoder_layers: 2,
        n_vae_encoder_layers: 1,
        backbone_norm: norm,
        ..ActConfig::lerobot_defaults(7, 7, &names, 64, 96)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
fn numbers(name: &str, shape: &[i64]) -> Tensor {
    let mut random = SplitMix64::named(name, 3);
    let values: Vec<f32> = (0..shape.iter().product::<i64>())
        .map(|_| random.signed_unit() as f32)
        .collect();
    Tensor::from_slice(&values).view(shape)
}

/// A network none of whose parameters is at a value that hides mistakes, such as a bias of zero.
fn trained(config: &ActConfig) -> Act {
    let fresh = Act::new(config.clone(), ParameterSource::seeded(5, Device::Cpu)).unwrap();
    let moved: BTreeMap<String, Tensor> = fresh
        .parameters()
        .iter()
        .map(|(key, tensor)| {
            let size = tensor.size();
            let nudge = numbers(key, &size) * if size.len() == 1 { 0.3 } else { 0.0 };
            (key.to_owned(), (tensor + nudge).set_requires_grad(true))
        })
        .collect();
    Act::new(config.clone(), ParameterSource::given(moved)).unwrap()
}

/// How far the folded network's chunk is from the trained one's, of the greatest number in the latter.
fn difference(config: &ActConfig, batch: i64) -> f64 {
    // As policies run; with more threads all convolutions are the library's.
    tch::set_num_threads(1);
    let act = trained(config);
    let mut folded = FoldedAct::new(&act, Kind::Float).unwrap();
    let cameras = i64::try_from(config.cameras.len()).unwrap();
    let images = numbers("images", &[batch, cameras, 3, 64, 96]) * 2.0;
    let state = numbers("state", &[batch, 7]);
    let (expected, actual) = tch::no_grad(|| {
        (
            act.infer(&images, &state).unwrap(),
            folded.infer(&images, &state).unwrap(),
        )
    });
    assert_eq!(expected.size(), actual.size());
    assert!(!actual.requires_grad());
    let scale = expected.abs().max().double_value(&[]);
    assert!(scale > 0.1, "the network says something: {scale}");
    (expected - actual).abs().max().double_value(&[]) / scale
}

#[track_caller]
fn check(config: &ActConfig, batch: i64) {
    let off = difference(config, batch);
    assert!(off <= ROUNDING, "off by {off:e}: {config:?}");
}

#[test]
fn folding_changes_nothing_but_rounding() {
    check(&config(BackboneNorm::FrozenBatchNorm, 1), 1);
    check(&config(BackboneNorm::GroupNorm, 1), 1);
}

#[test]
fn several_cameras_and_observations_keep_their_places() {
    check(&config(BackboneNorm::FrozenBatchNorm, 3), 2);
}

#[test]
fn further_decoder_layers_and_early_normalisation_fold_too() {
    for pre_norm in [false, true] {
        let several = ActConfig {
            n_decoder_layers: 3,
            pre_norm,
            ..config(BackboneNorm::GroupNorm, 1)
        };
        check(&several, 1);
        check(&several, 2);
    }
}

#[test]
fn same_observation_gives_same_bits() {
    tch::set_num_threads(1);
    let config = config(BackboneNorm::FrozenBatchNorm, 2);
    let mut folded = FoldedAct::new(&trained(&config), Kind::Float).unwrap();
    let images = numbers("images", &[1, 2, 3, 64, 96]);
    let state = numbers("state", &[1, 7]);
    let mut ask = || tch::no_grad(|| folded.infer(&images, &state)).unwrap();
    assert_eq!(ask(), ask());
}
