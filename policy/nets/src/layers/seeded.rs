//! Numbers for tests.

use tch::Tensor;

use hal::random::SplitMix64;

/// Numbers between -1 and 1, always the same of a name.
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
pub(super) fn numbers(name: &str, shape: &[i64]) -> Tensor {
    let mut random = SplitMix64::named(name, 7);
    let values: Vec<f32> = (0..shape.iter().product::<i64>())
        .map(|_| random.signed_unit() as f32)
        .collect();
    Tensor::from_slice(&values).view(shape)
}
