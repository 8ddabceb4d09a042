//! The feature map's size, and statistics in 16 bits.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::{BackboneNorm, Conv, ConvShape, FEATURE_CHANNELS, NORM_EPS, ResNet18};
use crate::parameters::ParameterSource;

#[test]
fn feature_map_has_the_foretold_size() {
    for norm in [BackboneNorm::GroupNorm, BackboneNorm::FrozenBatchNorm] {
        let mut source = ParameterSource::seeded(1, Device::Cpu);
        let backbone = ResNet18::new(&mut source, "model.backbone", norm).unwrap();
        let images = Tensor::zeros([1, 3, 70, 96], (Kind::Float, Device::Cpu));
        let (high, wide) = (ResNet18::feature_side(70), ResNet18::feature_side(96));
        assert_eq!(
            backbone.forward(&images).unwrap().size(),
            [1, FEATURE_CHANNELS, high, wide]
        );
    }
}

#[test]
fn statistics_are_folded_before_they_are_rounded() {
    // Means where numbers of 16 bits are whole ones at most, and biases that take nearly all of them back.
    let weight = [0.9_f32, 1.1, 1.3];
    let mean = [200.3_f32, -150.7, 90.2];
    let variance = [1.07_f32, 0.031, 7.7];
    let bias = [194.0_f32, -941.0, 43.0];
    let given = [
        ("norm.weight", &weight),
        ("norm.bias", &bias),
        ("norm.running_mean", &mean),
        ("norm.running_var", &variance),
    ];
    let mut given: BTreeMap<String, Tensor> = given
        .into_iter()
        .map(|(key, numbers)| (key.to_owned(), Tensor::from_slice(numbers)))
        .collect();
    let filters = Tensor::ones([3, 1, 1, 1], (Kind::BFloat16, Device::Cpu));
    given.insert("conv.weight".to_owned(), filters);
    let conv = Conv::new(
        &mut ParameterSource::given(given),
        &["conv".to_owned(), "norm".to_owned()],
        ConvShape {
            inputs: 1,
            outputs: 3,
            size: 1,
            stride: 1,
        },
        BackboneNorm::FrozenBatchNorm,
    )
    .unwrap();
    let x = Tensor::full([1, 3, 1, 1], 0.5, (Kind::BFloat16, Device::Cpu));
    let y = conv.norm.forward(&x).unwrap();
    assert_eq!((y.kind(), y.size()), (Kind::BFloat16, vec![1, 3, 1, 1]));
    for channel in 0..3 {
        let [weight, mean, variance, bias] =
            [weight, mean, variance, bias].map(|of| f64::from(of[channel]));
        let scale = weight / (variance + NORM_EPS).sqrt();
        let terms = [0.5 * scale, bias - mean * scale];
        let found = y.double_value(&[0, i64::try_from(channel).unwrap(), 0, 0]);
        let off = (found - terms[0] - terms[1]).abs();
        // Two roundings to eight bits of each term.
        let allowed = terms.map(f64::abs).iter().sum::<f64>() / 128.0;
        assert!(
            off <= allowed,
            "{channel}: {found}, off by {off} of {terms:?}"
        );
    }
}

/// A network whose tensors are those of another in `kind`, on `device`.
fn like(
    parameters: &crate::parameters::Parameters,
    kind: Kind,
    device: Device,
) -> BTreeMap<String, Tensor> {
    let of = |(key, tensor): (&str, &Tensor)| {
        // Filters with their channels last, as training lays them.
        let tensor = tensor
            .to_kind(Kind::BFloat16)
            .to_kind(kind)
            .to_device(device);
        let tensor = if tensor.dim() == 4 {
            super::by_hand::channels_last(&tensor).unwrap()
        } else {
            tensor
        };
        let trained = parameters.is_trainable(key);
        (key.to_owned(), tensor.detach().set_requires_grad(trained))
    };
    parameters.iter().map(of).collect()
}

#[test]
fn training_by_hand_finds_the_gradients_that_the_library_finds() {
    let device = Device::cuda_if_available();
    if !device.is_cuda() {
        return;
    }
    let kernels = crate::kernels::Kernels::new(device).unwrap();
    for norm in [BackboneNorm::GroupNorm, BackboneNorm::FrozenBatchNorm] {
        let mut source = ParameterSource::seeded(1, Device::Cpu);
        let _ = ResNet18::new(&mut source, "b", norm).unwrap();
        let parameters = source.finish().unwrap();
        let [exact, rounded] =
            [Kind::Double, Kind::BFloat16].map(|kind| like(&parameters, kind, device));
        let build = |tensors: &BTreeMap<String, Tensor>| {
            let given = tensors
                .iter()
                .map(|(key, tensor)| (key.clone(), tensor.shallow_clone()));
            ResNet18::new(&mut ParameterSource::given(given.collect()), "b", norm).unwrap()
        };
        let images = (Tensor::arange(4 * 3 * 96 * 64, (Kind::Double, device)) * 0.37).sin();
        let images = images.view([4, 3, 96, 64]).to_kind(Kind::BFloat16);
        let images = super::by_hand::channels_last(&images).unwrap();
        let gradient = (Tensor::arange(4 * 512 * 6, (Kind::Double, device)) * 0.73).cos();
        let gradient = gradient.view([4, 512, 3, 2]).to_kind(Kind::BFloat16);
        let trained: Vec<&String> = exact
            .keys()
            .filter(|key| parameters.is_trainable(key))
            .collect();
        let by_the_library = |tensors: &BTreeMap<String, Tensor>, kind| {
            let answer = build(tensors).forward(&images.to_kind(kind)).unwrap();
            let total = (&answer * &gradient.to_kind(kind)).sum(Kind::Double);
            let leaves: Vec<&Tensor> = trained.iter().map(|key| &tensors[*key]).collect();
            (
                answer,
                Tensor::run_backward(&[total], &leaves, false, false),
            )
        };
        let (wanted, wanted_gradients) = by_the_library(&exact, Kind::Double);
        let (rough, rough_gradients) = by_the_library(&rounded, Kind::BFloat16);
        let backbone = build(&rounded);
        let (answer, found) = tch::no_grad(|| {
            let (answer, kept) = backbone.forward_by_hand(&kernels, &images).unwrap();
            (
                answer,
                backbone
                    .backward_by_hand(&kernels, &gradient, &kept)
                    .unwrap(),
            )
        });
        // Their distance as a share of their length.
        let apart = |found: &Tensor, wanted: &Tensor| {
            let length = wanted.norm().double_value(&[]);
            (found.to_kind(Kind::Double) - wanted)
                .norm()
                .double_value(&[])
                / length
        };
        let allowed = 1.5 * apart(&rough, &wanted) + 0.01;
        assert!(
            apart(&answer, &wanted) < allowed,
            "{norm:?}: {}",
            apart(&answer, &wanted)
        );
        assert_eq!(found.len(), trained.len());
        for (index, key) in trained.iter().enumerate() {
            let own = rounded[*key].data_ptr();
            let mut all = found.iter();
            let (_, found) = all
                .find(|(parameter, _)| parameter.data_ptr() == own)
                .unwrap();
            let wanted = &wanted_gradients[index];
            let rough = apart(&rough_gradients[index], wanted);
            let apart = apart(found, wanted);
            assert!(
                apart < 1.5 * rough + 0.01,
                "{norm:?}: {key} is off by {apart}, the library by {rough}"
            );
        }
    }
}
