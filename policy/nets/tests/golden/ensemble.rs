//! Temporal ensembling: the action of every step at every coefficient.

use serde_json::Value;
use tch::Tensor;
use trocar_nets::ensemble::TemporalEnsemble;

use crate::compare::check_all;
use crate::regenerate::{input, numbers};

pub(crate) fn check(name: &str, case: &Value, seed: u64) {
    let size = |field: &str| {
        case[field]
            .as_u64()
            .unwrap_or_else(|| panic!("{name}: {field}"))
    };
    let (rows, width, steps) = (size("chunk_size"), size("action_dim"), size("steps"));
    let shape = [
        1,
        i64::try_from(rows).unwrap(),
        i64::try_from(width).unwrap(),
    ];
    let chunks: Vec<Vec<f32>> = (0..steps)
        .map(|step| input(&format!("chunk{step}"), seed, &shape).flatten(0, -1))
        .map(|chunk| Vec::try_from(chunk).unwrap())
        .collect();
    let (rows, width) = (
        usize::try_from(rows).unwrap(),
        usize::try_from(width).unwrap(),
    );
    for (decay, expected) in case["output"].as_object().unwrap() {
        let mut ensemble = TemporalEnsemble::new(decay.parse().unwrap(), rows, width);
        let emitted: Vec<f32> = chunks
            .iter()
            .flat_map(|chunk| ensemble.next(chunk).unwrap())
            .collect();
        let expected: Vec<f64> = expected
            .as_array()
            .unwrap()
            .iter()
            .flat_map(numbers)
            .collect();
        let what = format!("{name} at {decay}");
        check_all(&what, &Tensor::from_slice(&emitted), &expected, 1e-6);
    }
}
