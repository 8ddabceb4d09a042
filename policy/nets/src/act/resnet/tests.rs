//! The feature map's size, and statistics in 16 bits.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::{BackboneNorm, Conv, ConvShape, NORM_EPS, ResNet18, STAGES};
use crate::parameters::ParameterSource;

#[test]
fn feature_map_has_the_foretold_size() {
    for norm in [BackboneNorm::GroupNorm, BackboneNorm::FrozenBatchNorm] {
        for (stages, expected) in [(STAGES, [1, 512, 3, 3]), (3, [1, 256, 5, 6])] {
            let mut source = ParameterSource::seeded(1, Device::Cpu);
            let backbone = ResNet18::new(&mut source, "model.backbone", norm, stages).unwrap();
            let images = Tensor::zeros([1, 3, 70, 96], (Kind::Float, Device::Cpu));
            let [high, wide] = [70, 96].map(|side| ResNet18::feature_side(side, stages));
            let foretold = [1, ResNet18::feature_channels(stages), high, wide];
            assert_eq!(foretold, expected);
            assert_eq!(backbone.forward(&images).unwrap().size(), expected);
        }
    }
}

#[test]
fn statistics_are_folded_before_they_are_rounded() {
    // Means where numbers of 16 bits are whole ones at most, and biases that take nearly all of
    // them back.
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
