//! Steps of the flat optimiser against the library's, and what they keep.

use super::{FlatParameters, Rates};
use crate::{RunState, TrainOptions};
use tch::nn::{self, OptimizerConfig};
use tch::{Device, Kind, Tensor};
use trocar_nets::act::ActPreset;
use trocar_nets::parameters::{Init, ParameterSource};

#[test]
fn steps_are_those_of_the_library_s_adam_w() {
    let mut source = ParameterSource::seeded(2, Device::Cpu);
    let filter = source
        .trainable(
            "model.backbone.conv1.weight",
            &[2, 3, 2, 2],
            &Init::Normal(1.0),
        )
        .unwrap();
    let matrix = source
        .trainable("model.head.weight", &[4, 2], &Init::Normal(1.0))
        .unwrap();
    let parameters = source.finish().unwrap();
    let options = TrainOptions {
        weight_decay: 0.01,
        clip_norm: f64::INFINITY,
        ema_decay: 0.0,
        ..TrainOptions::preset(ActPreset::Small)
    };
    let mut flat = FlatParameters::new(&parameters, Device::Cpu, &options).unwrap();
    let ours = flat.working_tensors();

    let store = nn::VarStore::new(Device::Cpu);
    let filter = store.root().var_copy("filter", &filter);
    let matrix = store.root().var_copy("matrix", &matrix);
    let mut optimiser = nn::AdamW {
        wd: 0.01,
        ..nn::AdamW::default()
    }
    .build(&store, 0.01)
    .unwrap();

    let loss = |filter: &Tensor, matrix: &Tensor| {
        filter.sin().sum(Kind::Float) * matrix.square().sum(Kind::Float)
    };
    for step in 1..=5 {
        let own = loss(
            &ours["model.backbone.conv1.weight"],
            &ours["model.head.weight"],
        );
        let rates = Rates::of(step, [0.01, 0.01], &options);
        let _ = flat.step(&own, rates, &options).unwrap();
        optimiser.backward_step(&loss(&filter, &matrix));
    }
    let worst = (&ours["model.backbone.conv1.weight"] - &filter)
        .abs()
        .max()
        .double_value(&[]);
    assert!(worst < 1e-6, "{worst}");
    let worst = (&ours["model.head.weight"] - &matrix)
        .abs()
        .max()
        .double_value(&[]);
    assert!(worst < 1e-6, "{worst}");
}

/// Two like networks of two parts; the second one's parameters lie apart.
fn pair(options: &TrainOptions) -> [FlatParameters; 2] {
    [1, 64].map(|aligned| {
        let mut source = ParameterSource::seeded(7, Device::Cpu);
        for (key, shape) in [
            ("model.backbone.conv1.weight", &[8, 3, 3, 3][..]),
            ("model.head.weight", &[33, 5]),
        ] {
            let _ = source.trainable(key, shape, &Init::Normal(1.0)).unwrap();
        }
        let parameters = source.finish().unwrap();
        FlatParameters::laid(&parameters, (Device::Cpu, aligned), options).unwrap()
    })
}

#[test]
fn a_fused_step_is_a_step() {
    let options = TrainOptions {
        weight_decay: 0.05,
        clip_norm: 3.0,
        ema_decay: 0.9,
        ..TrainOptions::preset(ActPreset::Small)
    };
    let [mut plain, mut fused] = pair(&options);
    let loss = |flat: &FlatParameters| {
        let tensors = flat.working_tensors();
        let sines = tensors
            .values()
            .map(|tensor| tensor.sin().square().sum(Kind::Float));
        sines.reduce(|one, other| one * other).unwrap()
    };
    for step in 1..=20 {
        let rates = Rates::of(step, [0.02, 0.003], &options);
        let one = plain.step(&loss(&plain), rates, &options).unwrap();
        let rates = rates.sent(Device::Cpu).unwrap();
        let other = fused
            .fused_step(&loss(&fused), None, &rates, &options)
            .unwrap();
        let [one, other] = [one, other].map(|norm| norm.double_value(&[]));
        assert!(
            one > 3.0 && (one - other).abs() < 1e-3 * one,
            "{one}, {other}"
        );
    }
    let [start, mut resumed] = pair(&options);
    let [start, one, other] = [&start, &plain, &fused].map(|flat| flat.state().unwrap());
    assert_eq!(one.len(), 4);
    for (name, one) in &one {
        let other = &other[name];
        let apart = (one - other).abs().max().double_value(&[]);
        let moved = (one - &start[name]).abs().max().double_value(&[]);
        assert!(apart < 2e-4 * moved, "{name}: {apart} apart after {moved}");
    }
    // A state says nothing of where parameters lie.
    resumed
        .resume(&RunState::of(plain.state().unwrap()))
        .unwrap();
    let tensors = resumed.state().unwrap();
    assert!(one.iter().all(|(name, one)| tensors[name] == *one));
    let averaged = resumed.averaged_tensors().unwrap();
    let wanted = plain.averaged_tensors().unwrap();
    assert!(wanted.iter().all(|(key, wanted)| averaged[key] == *wanted));
}
