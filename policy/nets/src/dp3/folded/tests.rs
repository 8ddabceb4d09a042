//! Folded and trained networks give the same answers, to rounding.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::FoldedDp3;
use super::convolved::Backend;
use crate::dp3::{CloudObservation, Dp3, Dp3Config, Dp3Preset};
use crate::layers::vectors::Processor;
use crate::parameters::ParameterSource;

/// Of the greatest number in an answer, after all steps of the diffusion.
const ROUNDING: f64 = 1e-5;

fn config(preset: Dp3Preset, horizon: i64, kernel_size: i64) -> Dp3Config {
    Dp3Config {
        horizon,
        kernel_size,
        n_action_steps: 3,
        down_dims: vec![16, 24, 40],
        diffusion_step_embed_dim: 16,
        num_inference_steps: 5,
        ..Dp3Config::preset(preset, 7, 7)
    }
}

/// A network none of whose parameters is at a value that hides mistakes, such as a bias of zero.
fn trained(config: &Dp3Config) -> Dp3 {
    let fresh = Dp3::new(config.clone(), ParameterSource::seeded(5, Device::Cpu)).unwrap();
    let moved: BTreeMap<String, Tensor> = fresh
        .parameters()
        .iter()
        .map(|(key, tensor)| {
            let ramp = Tensor::arange(tensor.size()[0], (Kind::Float, Device::Cpu));
            let nudge = if tensor.dim() == 1 {
                ramp.sin() * 0.3
            } else {
                tensor.zeros_like()
            };
            (key.to_owned(), (tensor + nudge).set_requires_grad(true))
        })
        .collect();
    Dp3::new(config.clone(), ParameterSource::given(moved)).unwrap()
}

/// One with the same parameters, or with the nearest numbers of half precision.
fn again(network: &Dp3, halved: bool) -> Dp3 {
    let number = |tensor: &Tensor| {
        if halved {
            tensor.to_kind(Kind::Half).to_kind(Kind::Float)
        } else {
            tensor.shallow_clone()
        }
    };
    let parameters = network.parameters().iter();
    let parameters: BTreeMap<String, Tensor> = parameters
        .map(|(key, tensor)| (key.to_owned(), number(tensor)))
        .collect();
    Dp3::new(network.config().clone(), ParameterSource::given(parameters)).unwrap()
}

/// By the library, and by our own products with every kind of instructions that there is here.
fn means() -> Vec<Backend> {
    let own = Processor::all().into_iter();
    let own = own.map(|processor| Backend::Native(processor, 2));
    own.chain([Backend::Torch(Kind::Float)]).collect()
}

#[track_caller]
fn check(config: &Dp3Config) {
    assert_eq!(config.defect(), None);
    let network = trained(config);
    for network in [again(&network, true), network] {
        check_network(&network);
    }
}

#[track_caller]
fn check_network(network: &Dp3) {
    let ramp =
        |count: i64, rate: f64| (Tensor::arange(count, (Kind::Float, Device::Cpu)) * rate).sin();
    let observation = CloudObservation {
        points: &ramp(2 * 50 * 3, 0.7).view([1, 2, 50, 3]),
        state: &ramp(14, 1.3).view([1, 2, 7]),
    };
    let noise = network.config().start_noise(3, 1).unwrap();
    let other = network.config().start_noise(4, 1).unwrap();
    tch::no_grad(|| {
        let expected = network.infer(&observation, &noise).unwrap();
        let scale = expected.abs().max().double_value(&[]);
        for backend in means() {
            let mut folded = FoldedDp3::computed(again(network, false), backend).unwrap();
            let first = folded.infer(&observation, &noise).unwrap();
            let off = (&expected - &first).abs().max().double_value(&[]) / scale;
            assert!(
                off <= ROUNDING && scale > 0.1,
                "{backend:?}: off by {off:e} of {scale}"
            );
            // What it writes into is no part of the next answer.
            let between = folded.infer(&observation, &other).unwrap();
            assert_ne!(between, first);
            assert_eq!(folded.infer(&observation, &noise).unwrap(), first);
        }
    });
}

#[test]
fn single_precision_on_the_cpu_is_computed_by_our_own_products() {
    let found = Processor::found().is_some();
    let fastest = Backend::fastest(Kind::Float, Device::Cpu);
    assert_eq!(matches!(fastest, Backend::Native(..)), found);
    for (kind, device) in [
        (Kind::BFloat16, Device::Cpu),
        (Kind::Float, Device::Cuda(0)),
        (Kind::BFloat16, Device::Cuda(0)),
    ] {
        let fastest = Backend::fastest(kind, device);
        assert!(matches!(fastest, Backend::Torch(of) if of == kind));
    }
}

#[test]
fn folding_changes_nothing_but_rounding() {
    check(&config(Dp3Preset::Dp3, 16, 5));
    check(&config(Dp3Preset::Simple, 8, 3));
}

#[test]
fn blocks_of_outputs_fold_too() {
    for preset in [Dp3Preset::Dp3, Dp3Preset::Simple] {
        let wide = Dp3Config {
            down_dims: vec![128, 256],
            ..config(preset, 8, 5)
        };
        check(&wide);
    }
}

#[test]
fn fewer_steps_than_a_convolution_sees_fold_too() {
    check(&config(Dp3Preset::Simple, 4, 7));
}

#[test]
fn noise_of_another_shape_is_refused() {
    let config = config(Dp3Preset::Simple, 8, 3);
    let mut folded = FoldedDp3::new(trained(&config), Kind::Float).unwrap();
    let float = (Kind::Float, Device::Cpu);
    let observation = CloudObservation {
        points: &Tensor::zeros([1, 2, 50, 3], float),
        state: &Tensor::zeros([1, 2, 7], float),
    };
    for shape in [[2, 8, 7], [1, 16, 7], [1, 8, 6]] {
        let answer = folded.infer(&observation, &Tensor::zeros(shape, float));
        assert!(answer.unwrap_err().to_string().contains("noise"));
    }
}
