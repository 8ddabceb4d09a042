//! The training by hand beside the library's, on the device that has the kernels.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::by_hand::channels_last;
use super::{BackboneNorm, ResNet18, STAGES};
use crate::kernels::Kernels;
use crate::parameters::{ParameterSource, Parameters};

/// Tensors of a network, rounded to 16 bits, in `kind` on `device`, the trained ones with
/// gradients.
fn rounded(parameters: &Parameters, kind: Kind, device: Device) -> BTreeMap<String, Tensor> {
    let of = |(key, tensor): (&str, &Tensor)| {
        let tensor = tensor.to_kind(Kind::BFloat16).to_kind(kind);
        let tensor = tensor.to_device(device);
        // Filters with their channels last, as training lays them.
        let tensor = if tensor.dim() == 4 {
            channels_last(&tensor).unwrap()
        } else {
            tensor
        };
        let trained = parameters.is_trainable(key);
        (key.to_owned(), tensor.detach().set_requires_grad(trained))
    };
    parameters.iter().map(of).collect()
}

fn built(tensors: &BTreeMap<String, Tensor>, norm: BackboneNorm) -> ResNet18 {
    let shared = tensors.iter();
    let shared = shared.map(|(key, tensor)| (key.clone(), tensor.shallow_clone()));
    ResNet18::new(
        &mut ParameterSource::given(shared.collect()),
        "b",
        norm,
        STAGES,
    )
    .unwrap()
}

/// What went in, and the gradient of what comes out.
struct Seen {
    images: Tensor,
    gradient: Tensor,
}

impl Seen {
    fn new(device: Device) -> Self {
        // Without a pattern: of equal patches, all would be off by the same rounding.
        let drawn = |count, offset: f64| {
            let places = Tensor::arange(count, (Kind::Double, device)) * 12.9898 + offset;
            let numbers = places.sin() * 43_758.545;
            (&numbers - numbers.floor() - 0.5) * 3.4
        };
        let images = drawn(4 * 3 * 96 * 64, 0.0).view([4, 3, 96, 64]);
        let gradient = drawn(4 * 512 * 6, 1.0).view([4, 512, 3, 2]);
        Self {
            images: channels_last(&images.to_kind(Kind::BFloat16)).unwrap(),
            gradient: gradient.to_kind(Kind::BFloat16),
        }
    }

    /// The answer and the gradients that the library finds for the network of `tensors`, in their
    /// precision.
    fn by_the_library(
        &self,
        tensors: &BTreeMap<String, Tensor>,
        norm: BackboneNorm,
        kind: Kind,
    ) -> (Tensor, Vec<Tensor>) {
        let answer = built(tensors, norm)
            .forward(&self.images.to_kind(kind))
            .unwrap();
        let total = (&answer * &self.gradient.to_kind(kind)).sum(Kind::Double);
        let trained = tensors.values().filter(|tensor| tensor.requires_grad());
        let trained: Vec<&Tensor> = trained.collect();
        let gradients = Tensor::run_backward(&[total], &trained, false, false);
        (answer, gradients)
    }

    /// The same by hand.
    fn by_hand(
        &self,
        tensors: &BTreeMap<String, Tensor>,
        norm: BackboneNorm,
        kernels: &Kernels,
    ) -> (Tensor, Vec<Tensor>) {
        let backbone = built(tensors, norm);
        let (answer, found) = tch::no_grad(|| {
            let (answer, kept) = backbone.forward_by_hand(kernels, &self.images).unwrap();
            let found = backbone.backward_by_hand(kernels, &self.gradient, &kept);
            (answer, found.unwrap())
        });
        let of = |leaf: &Tensor| {
            let mut all = found.iter();
            let same = |(parameter, _): &&(Tensor, Tensor)| parameter.data_ptr() == leaf.data_ptr();
            all.find(same).unwrap().1.shallow_clone()
        };
        let trained = tensors.values().filter(|tensor| tensor.requires_grad());
        let gradients: Vec<Tensor> = trained.map(of).collect();
        assert_eq!(gradients.len(), found.len());
        (answer, gradients)
    }
}

/// The distance of each of `found` from its one of `wanted`, as a share of its length.
fn off(found: &[Tensor], wanted: &[Tensor]) -> Vec<f64> {
    let off = |(found, wanted): (&Tensor, &Tensor)| {
        let apart = (found.to_kind(Kind::Double) - wanted).norm();
        apart.double_value(&[]) / wanted.norm().double_value(&[])
    };
    found.iter().zip(wanted).map(off).collect()
}

#[test]
fn training_by_hand_finds_the_gradients_that_the_library_finds() {
    let device = Device::cuda_if_available();
    if !device.is_cuda() {
        return;
    }
    let (kernels, seen) = (Kernels::new(device).unwrap(), Seen::new(device));
    for norm in [BackboneNorm::GroupNorm, BackboneNorm::FrozenBatchNorm] {
        let mut source = ParameterSource::seeded(1, Device::Cpu);
        let _ = ResNet18::new(&mut source, "b", norm, STAGES).unwrap();
        let parameters = source.finish().unwrap();
        let exact = rounded(&parameters, Kind::Double, device);
        let half = rounded(&parameters, Kind::BFloat16, device);
        let (wanted, wanted_gradients) = seen.by_the_library(&exact, norm, Kind::Double);
        let (rough, rough_gradients) = seen.by_the_library(&half, norm, Kind::BFloat16);
        let (answer, gradients) = seen.by_hand(&half, norm, &kernels);
        let (answer, rough) = (
            off(&[answer], &[wanted.shallow_clone()]),
            off(&[rough], &[wanted]),
        );
        assert!(
            answer[0] < 1.2 * rough[0] + 0.005,
            "{norm:?}: {answer:?}, the library {rough:?}"
        );
        // How far off the library is by its own rounding is chance for one parameter, but not for
        // all of them.
        let [own, library] = [gradients, rough_gradients].map(|all| off(&all, &wanted_gradients));
        let sum = |all: &[f64]| all.iter().sum::<f64>();
        let most = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        assert!(
            sum(&own) < 1.3 * sum(&library) && most(&own) < 2.0 * most(&library),
            "{norm:?}: {own:?}, the library {library:?}"
        );
    }
}
