//! The library's numbers in double precision, to rounding; the same bits however weights lie in
//! memory and whatever instructions there are.

use half::f16;
use tch::{Kind, Tensor};

use super::weights::{F32, Weights, panels};
use super::{Columns, Narrow, Place, Windows};
use crate::layers::vectors::Processor;
use hal::random::SplitMix64;

/// Of the sum of the sizes of what is added up, which rounding goes by.
const ROUNDING: f64 = 1e-6;

/// All that this processor can be taken for. Where it is none of them, nothing here would be
/// tested.
fn processors() -> Vec<Processor> {
    let all = Processor::all();
    assert!(!all.is_empty(), "the tests need AVX2");
    all
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
fn numbers(name: &str, count: usize) -> Vec<f32> {
    let mut random = SplitMix64::named(name, 7);
    (0..count).map(|_| random.signed_unit() as f32).collect()
}

/// The nearest numbers of half precision.
fn halves(numbers: &[f32]) -> Vec<f32> {
    let near = |number: &f32| f16::from_f32(*number).to_f32();
    numbers.iter().map(near).collect()
}

fn tensor(numbers: &[f32], shape: [usize; 2]) -> Tensor {
    Tensor::from_slice(numbers).view(shape.map(|side| i64::try_from(side).unwrap()))
}

fn narrow(processor: Processor, weights: &[f32], outputs: usize) -> Narrow {
    let matrix = tensor(weights, [outputs, weights.len() / outputs]);
    let bias = Tensor::from_slice(&numbers("bias", outputs));
    Narrow::new(processor, &matrix, &bias).unwrap()
}

/// Of `x` `(rows, count)`, every row its own input.
fn columns(processor: Processor, x: &[f32], count: usize) -> Columns {
    let mut columns = Columns::default();
    // What is left of others is no part of the answer.
    let windows = |steps| Windows {
        steps,
        taps: 1,
        before: 0,
        stride: 1,
        count: steps,
    };
    columns.set(processor, &vec![f32::NAN; 3 * x.len()], windows(count));
    columns.set(processor, x, windows(count));
    columns
}

/// `(outputs, count)`.
fn product(narrow: &Narrow, x: &[f32], count: usize) -> Vec<f32> {
    let columns = columns(narrow.processor, x, count);
    let mut out = vec![f32::NAN; narrow.outputs() * count];
    let place = Place {
        first: 0,
        column: 1,
        output: count,
    };
    narrow.apply(&columns, &mut out, place, 1).unwrap();
    out
}

#[track_caller]
fn check(outputs: usize, rows: usize, count: usize) {
    let whole = numbers("weights", outputs * rows);
    let x = numbers("x", rows * count);
    for weights in [halves(&whole), whole] {
        let expected = tensor(&weights, [outputs, rows])
            .to_kind(Kind::Double)
            .matmul(&tensor(&x, [rows, count]).to_kind(Kind::Double))
            + Tensor::from_slice(&numbers("bias", outputs)).unsqueeze(1);
        let sizes = tensor(&weights, [outputs, rows])
            .abs()
            .matmul(&tensor(&x, [rows, count]).abs())
            + 1.0;
        let mut answers = Vec::new();
        for processor in processors() {
            let answer = product(&narrow(processor, &weights, outputs), &x, count);
            let off = (tensor(&answer, [outputs, count]) - &expected).abs() / &sizes;
            let off = off.max().double_value(&[]);
            assert!(off <= ROUNDING, "{processor:?}: off by {off:e}");
            answers.push(answer);
        }
        assert!(answers.windows(2).all(|pair| pair[0] == pair[1]));
    }
}

#[test]
fn products_of_whole_panels() {
    check(64, 320, 4);
    check(128, 96, 8);
    check(32, 250, 16);
}

#[test]
fn products_of_odd_sizes() {
    for (outputs, rows, count) in [
        (1, 1, 1),
        (7, 35, 16),
        (17, 3, 2),
        (100, 33, 5),
        (81, 129, 9),
        (55, 7, 37),
        (48, 11, 20),
        (250, 1001, 3),
    ] {
        check(outputs, rows, count);
    }
}

#[test]
fn every_number_of_half_precision_is_widened_exactly() {
    let every: Vec<f32> = (0..=u16::MAX)
        .map(|bits| f16::from_bits(bits).to_f32())
        .filter(|number| number.is_finite())
        .collect();
    for processor in processors() {
        let mut narrow = narrow(processor, &every, every.len());
        narrow.bias.fill(0.0);
        assert!(matches!(narrow.weights, Weights::F16(_)));
        assert_eq!(product(&narrow, &[1.0], 1), every);
    }
}

#[test]
fn weights_lie_in_the_fewest_bits_that_hold_all_of_them() {
    let half = halves(&numbers("weights", 96));
    assert!(matches!(Weights::new(&half, 6), Weights::F16(_)));
    let with = |odd: f32| {
        let mut weights = half.clone();
        weights[77] = odd;
        weights
    };
    // Below all numbers of half precision, above them, one bit too many, and what is no number.
    for odd in [1e-9, 65_520.0, 0.1, f32::NAN] {
        let weights = with(odd);
        assert!(
            matches!(Weights::new(&weights, 6), Weights::F32(_)),
            "{odd}"
        );
    }
    // Few bits, first within half precision, then far below it.
    let few: Vec<f32> = half
        .iter()
        .map(|number| f32::from_bits(number.to_bits() & 0xffff_0000))
        .collect();
    assert!(matches!(Weights::new(&few, 6), Weights::F16(_)));
    let tiny: Vec<f32> = few
        .iter()
        .map(|number| number * 2.0_f32.powi(-60))
        .collect();
    assert!(matches!(Weights::new(&tiny, 6), Weights::Bf16(_)));
    check_same_bits(&tiny, 6);
    check_same_bits(&half, 6);
}

/// However they lie in memory.
#[track_caller]
fn check_same_bits(weights: &[f32], rows: usize) {
    let outputs = weights.len() / rows;
    let x = numbers("x", rows * 4);
    for processor in processors() {
        let mut narrow = narrow(processor, weights, outputs);
        assert!(!matches!(narrow.weights, Weights::F32(_)));
        let answer = product(&narrow, &x, 4);
        narrow.weights = Weights::F32(panels(weights, rows).map(F32).collect());
        assert_eq!(product(&narrow, &x, 4), answer);
    }
}

#[test]
fn what_is_not_a_number_stays_so_and_stays_alone() {
    let mut weights = halves(&numbers("weights", 40 * 9));
    for odd in [f32::NAN, f32::INFINITY] {
        weights[13 * 9 + 5] = odd;
        for processor in processors() {
            let answer = product(&narrow(processor, &weights, 40), &numbers("x", 9 * 4), 4);
            for (index, number) in answer.iter().enumerate() {
                assert_eq!(!number.is_finite(), index / 4 == 13, "{index}: {number}");
            }
        }
    }
}

#[test]
fn windows_are_what_a_convolution_sees() {
    for processor in processors() {
        for (steps, taps, before, stride, count) in [
            (4, 5, 2, 1, 4),
            (8, 3, 1, 2, 4),
            (16, 3, 1, 2, 8),
            (3, 7, 3, 1, 3),
            (20, 5, 2, 1, 20),
            (40, 3, 1, 2, 20),
            (5, 2, 0, 1, 5),
        ] {
            let x = numbers("x", 6 * steps);
            let mut columns = Columns::default();
            let windows = Windows {
                steps,
                taps,
                before,
                stride,
                count,
            };
            columns.set(processor, &x, windows);
            let weights = numbers("weights", 10 * columns.rows());
            let narrow = narrow(processor, &weights, 10);
            let mut out = vec![0.0; 10 * count];
            let place = Place {
                first: 0,
                column: 1,
                output: count,
            };
            narrow.apply(&columns, &mut out, place, 1).unwrap();
            let side = |side: usize| i64::try_from(side).unwrap();
            let expected = Tensor::from_slice(&x)
                .view([1, 6, side(steps)])
                .constant_pad_nd([side(before), side(taps)])
                .conv1d(
                    &Tensor::from_slice(&weights).view([10, 6, side(taps)]),
                    Some(&Tensor::from_slice(&numbers("bias", 10))),
                    [side(stride)],
                    [0],
                    [1],
                    1,
                )
                .narrow(2, 0, side(count));
            let off = (expected.view([10, -1]) - tensor(&out, [10, count])).abs();
            assert!(off.max().double_value(&[]) < 1e-5, "{windows:?}");
        }
    }
}

#[test]
fn threads_change_no_bit() {
    // Three panels more than two threads can share evenly.
    let (outputs, rows) = (11 * 16 - 3, 4000);
    let weights = numbers("weights", outputs * rows);
    let x = numbers("x", rows * 5);
    for processor in processors() {
        let narrow = narrow(processor, &weights, outputs);
        let columns = columns(processor, &x, 5);
        let place = Place {
            first: 1,
            column: 2,
            output: 11,
        };
        let answer = |threads| {
            let mut out = vec![7.0; outputs * 11];
            narrow.apply(&columns, &mut out, place, threads).unwrap();
            out
        };
        assert!(size_of_val(weights.as_slice()) > 3 * super::WORTH_A_THREAD);
        let one = answer(1);
        let untouched = one
            .iter()
            .enumerate()
            .filter(|(index, _)| index % 11 % 2 == 0);
        assert!(
            untouched
                .clone()
                .all(|(_, number)| number.to_bits() == 7.0_f32.to_bits())
        );
        assert_eq!(untouched.count(), outputs * 6);
        for threads in [2, 3, 100] {
            assert_eq!(answer(threads), one);
        }
    }
}

#[test]
fn misfits_are_refused() {
    let processor = processors()[0];
    let matrix = tensor(&numbers("weights", 32 * 3), [32, 3]);
    let bias = Tensor::from_slice(&numbers("bias", 31));
    assert!(Narrow::new(processor, &matrix, &bias).is_err());
    let bias = Tensor::from_slice(&numbers("bias", 32));
    assert!(Narrow::new(processor, &matrix, &bias).is_ok());
    let empty = tensor(&[], [32, 0]);
    assert!(Narrow::new(processor, &empty, &bias).is_err());
    let narrow = narrow(processor, &numbers("weights", 32 * 3), 32);
    let place = Place {
        first: 1,
        column: 1,
        output: 4,
    };
    let fitting = columns(processor, &numbers("x", 3 * 4), 4);
    assert!(narrow.apply(&fitting, &mut [0.0; 128], place, 1).is_err());
    assert!(narrow.apply(&fitting, &mut [0.0; 129], place, 1).is_ok());
    let other = columns(processor, &numbers("x", 4 * 4), 4);
    assert!(narrow.apply(&other, &mut [0.0; 129], place, 1).is_err());
}
