//! The library's numbers in double precision, to rounding; the same bits whatever instructions
//! there are.

use tch::{Kind, Tensor};

use super::{Epilogue, Matrix};
use crate::layers::seeded::numbers;
use crate::layers::vectors::Processor;

/// Of the sum of the sizes of what is added up, which rounding goes by.
const ROUNDING: f64 = 1e-6;

fn list(tensor: &Tensor) -> Vec<f32> {
    Vec::try_from(tensor.view([-1])).unwrap()
}

/// All that this processor can be taken for. Where it is none of them, nothing here would be
/// tested.
fn processors() -> Vec<Processor> {
    let all = Processor::all();
    assert!(!all.is_empty(), "the tests need AVX2");
    all
}

fn apply(processor: Processor, [x, weight, bias]: [&Tensor; 3], rectified: bool) -> Tensor {
    let bias = &list(bias);
    let matrix = Matrix::new(processor, weight).unwrap();
    matrix.apply(x, Epilogue { bias, rectified }).unwrap()
}

/// `bias_rows` is 1 for a bias that all rows share.
#[track_caller]
fn check([rows, inputs, outputs]: [i64; 3], bias_rows: i64, rectified: bool) {
    let x = numbers("x", &[rows, inputs]);
    let weight = numbers("weight", &[outputs, inputs]);
    let bias = numbers("bias", &[bias_rows, outputs]);
    let [exact_x, exact_weight] = [&x, &weight].map(|it| it.to_kind(Kind::Double));
    let placed = bias.repeat([rows / bias_rows, 1]);
    let mut expected = exact_x.matmul(&exact_weight.tr()) + &placed;
    if rectified {
        expected = expected.relu();
    }
    let sizes = exact_x.abs().matmul(&exact_weight.abs().tr()) + placed.abs();
    let mut answers = Vec::new();
    for processor in processors() {
        let answer = apply(processor, [&x, &weight, &bias], rectified);
        assert_eq!(answer.size(), [rows, outputs]);
        let off = ((&answer - &expected).abs() / &sizes)
            .max()
            .double_value(&[]);
        assert!(off <= ROUNDING, "{processor:?}: off by {off:e}");
        answers.push(list(&answer));
    }
    assert!(answers.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn products_of_any_number_of_rows() {
    for rows in [1, 2, 3, 7, 8, 9, 10, 16, 23] {
        check([rows, 24, 64], 1, false);
    }
}

#[test]
fn rows_and_inputs_of_several_blocks() {
    check([531, 40, 32], 1, true);
    check([11, 1300, 96], 1, false);
    check([266, 600, 32], 1, true);
}

#[test]
fn numbers_of_inputs_that_are_no_multiple_of_anything() {
    for inputs in [1, 5, 7, 13, 255, 257, 511, 513, 519] {
        check([9, inputs, 32], 1, false);
    }
}

#[test]
fn rows_have_the_bias_of_their_place() {
    check([12, 32, 64], 4, false);
    check([12, 32, 64], 12, true);
}

#[test]
fn rows_may_lie_within_those_of_another() {
    let [x, weight] = [numbers("x", &[9, 16]), numbers("weight", &[32, 16])];
    let bias = numbers("bias", &[32]);
    let whole = apply(processors()[0], [&x, &weight, &bias], false);
    let part = apply(processors()[0], [&x.narrow(0, 3, 4), &weight, &bias], false);
    assert_eq!(part, whole.narrow(0, 3, 4));
}

#[test]
fn no_rows_give_none() {
    let empty = numbers("x", &[0, 8]);
    let weight = numbers("weight", &[32, 8]);
    let answer = apply(
        processors()[0],
        [&empty, &weight, &numbers("bias", &[32])],
        true,
    );
    assert_eq!(answer.size(), [0, 32]);
}

#[test]
fn what_is_not_a_number_stays_so_and_in_its_row() {
    let x = numbers("x", &[11, 300]);
    let _ = x.get(10).get(299).fill_(f64::NAN);
    for processor in processors() {
        let [weight, bias] = [numbers("weight", &[32, 300]), numbers("bias", &[32])];
        let rows = apply(processor, [&x, &weight, &bias], true).isnan();
        let each: Vec<bool> = (0..11)
            .map(|row| rows.get(row).any().int64_value(&[]) == 1)
            .collect();
        assert!(each[10] && !each[..10].contains(&true), "{each:?}");
        assert!(bool::try_from(rows.get(10).all()).unwrap());
    }
}

#[test]
fn misfits_are_refused() {
    let processor = processors()[0];
    for shape in [
        &[31_i64, 8] as &[i64],
        &[0, 8],
        &[32, 0],
        &[32],
        &[32, 4, 2],
    ] {
        assert!(
            Matrix::new(processor, &numbers("weight", shape)).is_err(),
            "{shape:?}"
        );
    }
    let matrix = Matrix::new(processor, &numbers("weight", &[32, 8])).unwrap();
    let refused = |x: &Tensor, bias: usize| {
        let bias = &vec![0.0; bias];
        let rectified = false;
        let error = matrix.apply(x, Epilogue { bias, rectified }).unwrap_err();
        error.to_string()
    };
    let x = numbers("x", &[6, 8]);
    assert!(refused(&numbers("x", &[6, 9]), 32).contains("[6, 9] into 8 inputs"));
    assert!(refused(&x, 0).contains("bias of 0 for 6 rows"));
    for bias in [31, 33, 4 * 32, 7 * 32] {
        assert!(refused(&x, bias).contains("for 6 rows"), "{bias}");
    }
    assert!(refused(&x.to_kind(Kind::Double), 32).contains("single precision"));
    assert!(refused(&numbers("x", &[8, 6]).tr(), 32).contains("contiguous"));
}
