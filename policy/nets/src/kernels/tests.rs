//! The kernels beside the library's own operations, on the device that has them.

use tch::{Device, Kind, Tensor};

use super::{Affine, Kernels};

/// Numbers without a pattern, rounded to 16 bits.
fn numbers(size: &[i64], offset: f64) -> Tensor {
    let count = size.iter().product::<i64>();
    let numbers =
        (Tensor::arange(count, (Kind::Double, Device::Cpu)) * 12.9898 + offset).sin() * 43_758.545;
    let numbers = (&numbers - numbers.floor() - 0.4) * 3.0;
    numbers
        .view(size)
        .to_kind(Kind::BFloat16)
        .to_device(Device::cuda_if_available())
}

fn last(x: &Tensor) -> Tensor {
    x.permute([0, 2, 3, 1]).contiguous().permute([0, 3, 1, 2])
}

/// By how much of its greatest number `found` is off at most.
fn off(found: &Tensor, wanted: &Tensor) -> f64 {
    let (found, wanted) = (found.to_kind(Kind::Double), wanted.to_kind(Kind::Double));
    let greatest = wanted.abs().max().double_value(&[]);
    (found - wanted).abs().max().double_value(&[]) / greatest
}

/// One normalisation as it stands in a block.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// Images, channels, rows, columns.
    size: [i64; 4],
    grouped: bool,
    identity: bool,
    pooled: bool,
}

/// What goes into it: images, scale, bias, identity.
type Given = [Tensor; 4];

impl Case {
    fn given(self) -> Given {
        let channels = &self.size[1..2];
        let images = |offset| last(&numbers(&self.size, offset));
        [
            images(0.0),
            numbers(channels, 1.0),
            numbers(channels, 2.0),
            images(3.0),
        ]
    }

    /// The answer by the library in double precision, a gradient for it, and the gradients of what
    /// is given.
    fn by_the_library(self, given: &Given) -> (Tensor, Tensor, Vec<Tensor>) {
        let leaves = given.each_ref().map(|tensor| {
            let tensor = tensor.to_kind(Kind::Double);
            tensor.detach().set_requires_grad(true)
        });
        let [x, scale, bias, beside] = &leaves;
        let mut z = if self.grouped {
            x.group_norm(self.size[1] / 16, Some(scale), Some(bias), 1e-5, false)
        } else {
            x * scale.view([1, -1, 1, 1]) + bias.view([1, -1, 1, 1])
        };
        if self.identity {
            z = &z + beside;
        }
        if self.pooled {
            z = z.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
        }
        let answer = z.relu();
        let gradient = last(&numbers(&answer.size(), 4.0));
        let total = (&answer * &gradient.to_kind(Kind::Double)).sum(Kind::Double);
        let leaves = &leaves[..if self.identity { 4 } else { 3 }];
        let gradients = Tensor::run_backward(&[total], leaves, false, false);
        (answer, gradient, gradients)
    }

    /// The answer by the kernels, and the gradients that there are of what is given.
    fn by_the_kernels(
        self,
        kernels: &Kernels,
        [x, scale, bias, beside]: &Given,
        gradient: &Tensor,
    ) -> (Tensor, [Option<Tensor>; 4]) {
        let affine = if self.grouped {
            Affine::Group(scale, bias)
        } else {
            Affine::Fixed(scale, bias)
        };
        let (answer, of_x, of_affine, of_identity) = if self.pooled {
            let kept = kernels.pooled(x.shallow_clone(), &affine).unwrap();
            let back = kernels.pooled_backward(gradient, &kept, &affine);
            let (of_x, of_affine) = back.unwrap();
            (kept.0, of_x, of_affine, None)
        } else {
            let beside = self.identity.then_some(beside);
            let there = kernels.forward(x.shallow_clone(), &affine, beside, true);
            let (answer, kept) = there.unwrap();
            let seen = self.identity.then_some(&answer);
            let back = kernels.backward(gradient, &kept, &affine, seen, true);
            let (of_x, of_affine, of_identity) = back.unwrap();
            (answer, of_x, of_affine, of_identity)
        };
        let (of_scale, of_bias) = of_affine.unzip();
        (answer, [Some(of_x), of_scale, of_bias, of_identity])
    }

    fn check(self) {
        let device = Device::cuda_if_available();
        if !device.is_cuda() {
            return;
        }
        let (kernels, given) = (Kernels::new(device).unwrap(), self.given());
        let (wanted, gradient, wanted_gradients) = self.by_the_library(&given);
        let (answer, gradients) = self.by_the_kernels(&kernels, &given, &gradient);
        assert!(
            off(&answer, &wanted) < 6e-3,
            "{self:?}: {}",
            off(&answer, &wanted)
        );
        let there = gradients.each_ref().map(Option::is_some);
        assert_eq!(there, [true, self.grouped, self.grouped, self.identity]);
        for (index, found) in gradients.iter().enumerate() {
            if let Some(found) = found {
                let off = off(found, &wanted_gradients[index]);
                assert!(off < 6e-3, "{self:?}: gradient {index} is off by {off}");
            }
        }
    }
}

#[test]
fn normalisations_are_those_of_the_library_forward_and_back() {
    for grouped in [true, false] {
        for (channels, side) in [(64, 33), (128, 16), (256, 8), (512, 5)] {
            for identity in [false, true] {
                Case {
                    size: [3, channels, side, side + 1],
                    grouped,
                    identity,
                    pooled: false,
                }
                .check();
            }
        }
        for size in [[5, 64, 32, 32], [2, 64, 33, 31]] {
            Case {
                size,
                grouped,
                identity: false,
                pooled: true,
            }
            .check();
        }
    }
}

#[test]
fn what_the_kernels_do_not_take_is_refused() {
    let device = Device::cuda_if_available();
    if !device.is_cuda() {
        assert!(Kernels::new(Device::Cpu).is_err());
        return;
    }
    let kernels = Kernels::new(device).unwrap();
    let (scale, bias) = (numbers(&[64], 1.0), numbers(&[64], 2.0));
    let affine = Affine::Fixed(&scale, &bias);
    let good = numbers(&[2, 64, 5, 6], 0.0);
    for bad in [
        good.shallow_clone(),
        last(&good).to_kind(Kind::Float),
        last(&numbers(&[2, 48, 5, 6], 0.0)),
    ] {
        assert!(kernels.forward(bad, &affine, None, true).is_err());
    }
    let beside = last(&numbers(&[2, 64, 6, 5], 0.0));
    assert!(
        kernels
            .forward(last(&good), &affine, Some(&beside), true)
            .is_err()
    );
    assert!(kernels.forward(last(&good), &affine, None, true).is_ok());
}
