//! Folded and trained networks give the same answers, to rounding.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::FoldedAct;
use super::backbone::FoldedBackbone;
use crate::act::{Act, ActConfig, BackboneNorm};
use crate::layers::affine::Backend;
use crate::layers::vectors::Processor;
use crate::parameters::ParameterSource;
use hal::random::SplitMix64;

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
        dim_feedforward: 64,
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

/// The library and, where the processor allows it, code of ours.
fn means() -> Vec<Backend> {
    let own = Processor::found().map(Backend::Native);
    own.into_iter()
        .chain([Backend::Torch(Kind::Float)])
        .collect()
}

/// Every folded network's chunk is the trained one's.
#[track_caller]
fn check(config: &ActConfig, batch: i64) {
    let act = trained(config);
    let cameras = i64::try_from(config.cameras.len()).unwrap();
    let images = numbers("images", &[batch, cameras, 3, 64, 96]) * 2.0;
    let state = numbers("state", &[batch, 7]);
    let expected = tch::no_grad(|| act.infer(&images, &state)).unwrap();
    let scale = expected.abs().max().double_value(&[]);
    assert!(scale > 0.1, "the network says something: {scale}");
    for backend in means() {
        let way = format!("{backend:?}");
        let mut folded = FoldedAct::computed(&act, backend).unwrap();
        let actual = tch::no_grad(|| folded.infer(&images, &state)).unwrap();
        assert_eq!(expected.size(), actual.size());
        assert!(!actual.requires_grad());
        let off = (&expected - actual).abs().max().double_value(&[]) / scale;
        assert!(off <= ROUNDING, "off by {off:e}: {way}, {config:?}");
    }
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
#[cfg(target_arch = "x86_64")]
fn only_fixed_normalisations_go_into_convolutions_of_ours() {
    let backend = Backend::Native(Processor::found().expect("the tests need AVX2"));
    for (norm, own) in [
        (BackboneNorm::FrozenBatchNorm, true),
        (BackboneNorm::GroupNorm, false),
    ] {
        let folded = FoldedAct::computed(&trained(&config(norm, 1)), backend).unwrap();
        let backbone = &folded.network.backbone;
        assert_eq!(
            matches!(backbone, FoldedBackbone::Native(_)),
            own,
            "{norm:?}"
        );
    }
}

#[test]
fn same_observation_gives_same_bits() {
    let config = config(BackboneNorm::FrozenBatchNorm, 2);
    let act = trained(&config);
    let images = numbers("images", &[1, 2, 3, 64, 96]);
    let state = numbers("state", &[1, 7]);
    for backend in means() {
        let mut folded = FoldedAct::computed(&act, backend).unwrap();
        let mut ask = || tch::no_grad(|| folded.infer(&images, &state)).unwrap();
        assert_eq!(ask(), ask());
    }
}
