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

/// One normalisation, grouped or fixed, as it stands in a block.
fn check([images, channels, high, wide]: [i64; 4], grouped: bool, identity: bool, pooled: bool) {
    let device = Device::cuda_if_available();
    if !device.is_cuda() {
        return;
    }
    let kernels = Kernels::new(device).unwrap();
    let x = last(&numbers(&[images, channels, high, wide], 0.0));
    let (scale, bias) = (numbers(&[channels], 1.0), numbers(&[channels], 2.0));
    let beside = last(&numbers(&[images, channels, high, wide], 3.0));
    let exact = |tensor: &Tensor| {
        tensor
            .to_kind(Kind::Double)
            .detach()
            .set_requires_grad(true)
    };
    let leaves = [exact(&x), exact(&scale), exact(&bias), exact(&beside)];
    let [x_leaf, scale_leaf, bias_leaf, beside_leaf] = &leaves;
    let mut z = if grouped {
        x_leaf.group_norm(
            channels / 16,
            Some(scale_leaf),
            Some(bias_leaf),
            1e-5,
            false,
        )
    } else {
        x_leaf * scale_leaf.view([1, -1, 1, 1]) + bias_leaf.view([1, -1, 1, 1])
    };
    if identity {
        z = &z + beside_leaf;
    }
    if pooled {
        z = z.max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false);
    }
    let wanted = z.relu();
    let gradient = last(&numbers(&wanted.size(), 4.0));
    let total = (&wanted * &gradient.to_kind(Kind::Double)).sum(Kind::Double);
    let wanted_gradients = Tensor::run_backward(
        &[total],
        &leaves[..if identity { 4 } else { 3 }],
        false,
        false,
    );
    let affine = if grouped {
        Affine::Group(&scale, &bias)
    } else {
        Affine::Fixed(&scale, &bias)
    };
    let (answer, of_x, of_affine, of_identity) = if pooled {
        let kept = kernels.pooled(x, &affine).unwrap();
        let (of_x, of_affine) = kernels.pooled_backward(&gradient, &kept, &affine).unwrap();
        (kept.0, of_x, of_affine, None)
    } else {
        let beside = identity.then_some(&beside);
        let (answer, kept) = kernels.forward(x, &affine, beside, true).unwrap();
        let seen = identity.then_some(&answer);
        let (of_x, of_affine, of_identity) = kernels
            .backward(&gradient, &kept, &affine, seen, true)
            .unwrap();
        (answer, of_x, of_affine, of_identity)
    };
    let mut found = vec![
        (answer, wanted),
        (of_x, wanted_gradients[0].shallow_clone()),
    ];
    if let Some((of_scale, of_bias)) = of_affine {
        found.push((of_scale, wanted_gradients[1].shallow_clone()));
        found.push((of_bias, wanted_gradients[2].shallow_clone()));
    }
    assert_eq!(of_identity.is_some(), identity);
    if let Some(of_identity) = of_identity {
        found.push((of_identity, wanted_gradients[3].shallow_clone()));
    }
    for (index, (found, wanted)) in found.iter().enumerate() {
        let off = off(found, wanted);
        assert!(
            off < 6e-3,
            "{channels} {high} x {wide} {grouped} {identity} {pooled}: {index} is off by {off}"
        );
    }
}

#[test]
fn normalisations_are_those_of_the_library_forward_and_back() {
    for grouped in [true, false] {
        for (channels, side) in [(64, 33), (128, 16), (256, 8), (512, 5)] {
            check([3, channels, side, side + 1], grouped, false, false);
            check([3, channels, side, side + 1], grouped, true, false);
        }
        check([5, 64, 32, 32], grouped, false, true);
        check([2, 64, 33, 31], grouped, false, true);
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
