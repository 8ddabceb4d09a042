//! What DP3 promises beyond the golden numbers: names, sizes, determinism, order of points,
//! training.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::blocks::{Convolution, Doubling};
use super::{CloudObservation, Dp3, Dp3Config, Dp3Preset};
use crate::parameters::ParameterSource;

fn seeded(config: &Dp3Config) -> Dp3 {
    Dp3::new(config.clone(), ParameterSource::seeded(3, Device::Cpu)).unwrap()
}

/// A network small enough for a test, with other sizes than the published ones.
fn small() -> Dp3Config {
    Dp3Config {
        horizon: 12,
        n_obs_steps: 3,
        n_action_steps: 4,
        down_dims: vec![16, 24, 32],
        kernel_size: 3,
        blocks: 2,
        ..Dp3Config::preset(Dp3Preset::Simple, 5, 4)
    }
}

fn observed(config: &Dp3Config, batch: i64) -> (Tensor, Tensor) {
    let wave = |shape: &[i64]| {
        let count = shape.iter().product::<i64>();
        let places = Tensor::arange(count, (Kind::Float, Device::Cpu));
        (places * 0.37_f64).sin().view(shape)
    };
    let steps = config.n_obs_steps;
    (
        wave(&[batch, steps, 40, 3]),
        wave(&[batch, steps, config.state_dim]),
    )
}

fn shapes(config: &Dp3Config) -> BTreeMap<String, Vec<i64>> {
    let network = seeded(config);
    let entries = network.parameters().iter();
    entries
        .map(|(key, tensor)| (key.to_owned(), tensor.size()))
        .collect()
}

#[test]
fn a_doubling_convolution_is_a_product_of_matrices() {
    let mut source = ParameterSource::seeded(5, Device::Cpu);
    let doubling = Doubling::new(&mut source, "doubling", 6).unwrap();
    for steps in [2, 5] {
        let x = Tensor::arange(3 * 6 * steps, (Kind::Float, Device::Cpu)).sin();
        let x = x.view([3, 6, steps]);
        let (doubled, product) = (doubling.forward(&x).unwrap(), doubling.product(&x).unwrap());
        assert_eq!(product.size(), [3, 6, 2 * steps]);
        let worst = (doubled - product).abs().max().double_value(&[]);
        assert!(worst < 1e-5, "{worst}");
    }
}

#[test]
fn a_convolution_is_a_product_of_matrices() {
    for (kernel, stride, steps) in [(5, 1, 4), (3, 2, 8), (1, 1, 4)] {
        let mut source = ParameterSource::seeded(7, Device::Cpu);
        let convolution = Convolution::new(&mut source, "c", [6, 10], kernel, stride).unwrap();
        let places = Tensor::arange(2 * 6 * steps, (Kind::Float, Device::Cpu));
        let x = (places * 0.7_f64).sin().view([2, 6, steps]);
        let found = [
            convolution.forward(&x).unwrap(),
            convolution.product(&x).unwrap(),
        ];
        assert_eq!(found[0].size(), found[1].size());
        let off = (&found[0] - &found[1]).abs().max().double_value(&[]);
        assert!(off < 1e-6, "{kernel}, {stride}: {off}");
    }
}

#[test]
fn names_and_sizes_are_the_published_ones() {
    let shapes = shapes(&Dp3Config::preset(Dp3Preset::Simple, 9, 7));
    let published: [(&str, &[i64]); 14] = [
        ("obs_encoder.extractor.mlp.0.weight", &[64, 3]),
        ("obs_encoder.extractor.mlp.7.bias", &[256]),
        ("obs_encoder.extractor.final_projection.1.weight", &[64]),
        ("obs_encoder.state_mlp.2.weight", &[64, 64]),
        (
            "model.mid_modules.0.blocks.1.block.0.weight",
            &[384, 384, 5],
        ),
        ("model.diffusion_step_encoder.1.weight", &[512, 128]),
        ("model.diffusion_step_encoder.3.bias", &[128]),
        (
            "model.up_modules.0.0.blocks.0.block.0.weight",
            &[256, 768, 5],
        ),
        ("model.up_modules.1.0.cond_encoder.1.weight", &[256, 384]),
        ("model.up_modules.1.1.conv.weight", &[128, 128, 4]),
        ("model.down_modules.0.0.residual_conv.weight", &[128, 7, 1]),
        ("model.down_modules.1.1.conv.weight", &[256, 256, 3]),
        ("model.down_modules.2.0.cond_encoder.1.bias", &[768]),
        ("model.final_conv.1.weight", &[7, 128, 1]),
    ];
    for (key, shape) in published {
        assert_eq!(shapes.get(key).map(Vec::as_slice), Some(shape), "{key}");
    }
    assert!(!shapes.contains_key("model.down_modules.2.1.conv.weight"));
    let count = |prefix: &str| -> i64 {
        let under = shapes.iter().filter(|(key, _)| key.starts_with(prefix));
        under.map(|(_, shape)| shape.iter().product::<i64>()).sum()
    };
    assert_eq!(count("obs_encoder."), 63_872);
    let unet = count("model.");
    assert!(
        (7_377_500..7_378_500).contains(&unet),
        "7.378 million, not {unet}"
    );
}

/// The same seed gives the same actions, and each answer of an episode other noise.
#[test]
fn actions_depend_on_the_seed_and_the_answer_s_number() {
    let config = small();
    let network = seeded(&config);
    let (points, state) = observed(&config, 1);
    let observation = CloudObservation {
        points: &points,
        state: &state,
    };
    let infer = |seed, answer| {
        let noise = config.start_noise(seed, answer).unwrap();
        let actions = tch::no_grad(|| network.infer(&observation, &noise)).unwrap();
        assert_eq!(actions.size(), [1, 12, 4]);
        let executed = network.executed(&actions).unwrap();
        assert_eq!(executed, actions.narrow(1, 2, 4));
        Vec::<f32>::try_from(actions.flatten(0, -1)).unwrap()
    };
    let first = infer(7, 0);
    assert_eq!(first, infer(7, 0));
    assert_ne!(first, infer(7, 1));
    assert_ne!(first, infer(8, 0));
    assert!(first.iter().all(|x| x.abs() <= 1.0), "inside the limits");
}

#[test]
fn start_noise_is_standard_normal() {
    let config = Dp3Config {
        horizon: 1000,
        ..small()
    };
    let noise = config.start_noise(1, 2).unwrap();
    let (mean, deviation) = (noise.mean(Kind::Double), noise.std(true));
    assert!(mean.double_value(&[]).abs() < 0.05);
    assert!((deviation.double_value(&[]) - 1.0).abs() < 0.05);
}

#[test]
fn the_order_of_the_points_does_not_matter() {
    let config = small();
    let network = seeded(&config);
    let (points, state) = observed(&config, 2);
    let features = |points: &Tensor| {
        let state = &state;
        network
            .features(&CloudObservation { points, state })
            .unwrap()
    };
    let straight = features(&points);
    assert_eq!(straight.size(), [6, 128]);
    assert_eq!(straight, features(&points.flip([2])));
}

#[test]
fn training_lowers_the_loss_and_reaches_every_parameter() {
    let config = small();
    let network = seeded(&config);
    for (_, tensor) in network.parameters().iter() {
        let _ = tensor.set_requires_grad(true);
    }
    let (points, state) = observed(&config, 4);
    let observation = CloudObservation {
        points: &points,
        state: &state,
    };
    let shape = [4, config.horizon, config.action_dim];
    let places = Tensor::arange(4 * 12 * 4, (Kind::Float, Device::Cpu));
    let actions = (&places * 0.11_f64).sin().view(shape) * 0.8_f64;
    let noise = (&places * 1.7_f64).cos().view(shape);
    let timestep = Tensor::from_slice(&[3_i64, 40, 77, 99]);
    let loss = || {
        network
            .loss(&observation, &actions, &noise, &timestep)
            .unwrap()
    };
    let before = loss();
    before.backward();
    for (key, tensor) in network.parameters().iter() {
        let norm = tensor.grad().norm().double_value(&[]);
        assert!(
            norm.is_finite() && norm > 0.0,
            "{key} has the gradient {norm}"
        );
    }
    tch::no_grad(|| {
        for (_, tensor) in network.parameters().iter() {
            let step = tensor.grad() * -0.01_f64;
            let _ = tensor.shallow_clone().f_add_(&step).unwrap();
        }
    });
    let (before, after) = (before.double_value(&[]), loss().double_value(&[]));
    assert!(after < before, "{before} then {after}");
}
