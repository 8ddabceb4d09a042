//! The recipe of the golden file for weights and inputs, written down again on purpose.

use serde_json::Value;
use tch::Tensor;

/// The numbers -1 to 1 that belong to `key`.
fn regenerate(key: &str, seed: u64, count: i64) -> impl Iterator<Item = f64> {
    let mut state = 0xcbf2_9ce4_8422_2325_u64;
    for byte in key.bytes() {
        state = (state ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    }
    state ^= seed;
    (0..u64::try_from(count).unwrap()).map(move |i| {
        let z = state.wrapping_add((i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let z = z ^ (z >> 31);
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit")]
        let unit = (z >> 11) as f64 * 2.0_f64.powi(-52) - 1.0;
        unit
    })
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "computed in double precision, then rounded, as the recipe says"
)]
fn tensor(values: impl Iterator<Item = f64>, shape: &[i64]) -> Tensor {
    let values: Vec<f32> = values.map(|value| value as f32).collect();
    Tensor::from_slice(&values).view(shape)
}

pub(crate) fn input(name: &str, seed: u64, shape: &[i64]) -> Tensor {
    tensor(
        regenerate(&format!("input/{name}"), seed, shape.iter().product()),
        shape,
    )
}

pub(crate) fn weight(key: &str, seed: u64, shape: &[i64]) -> Tensor {
    let draws = regenerate(key, seed, shape.iter().product());
    if key.ends_with("running_var") {
        return tensor(draws.map(|u| 1.0 + 0.5 * u), shape);
    }
    if shape.len() == 1 {
        let offset = if key.ends_with("weight") { 1.0 } else { 0.0 };
        return tensor(draws.map(|u| offset + 0.1 * u), shape);
    }
    let fan_in = f64::from(i32::try_from(shape[1..].iter().product::<i64>()).unwrap());
    tensor(draws.map(|u| u * (3.0 / fan_in).sqrt()), shape)
}

pub(crate) fn integer(value: &Value, default: i64) -> i64 {
    if value.is_null() {
        default
    } else {
        value.as_i64().unwrap()
    }
}

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

pub(crate) fn whole_numbers(value: &Value) -> Vec<i64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_i64().unwrap())
        .collect()
}
