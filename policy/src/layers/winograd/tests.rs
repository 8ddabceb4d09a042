//! The same numbers as the library's plain convolution in double precision, to rounding.

use tch::{Device, Kind, TchError, Tensor};

use super::{Winograd, Workspace};
use crate::rng::SplitMix64;

/// Of the greatest number in an answer; the library's in single precision is off by up to 7e-7 here.
const ROUNDING: f64 = 2e-6;

#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
fn numbers(name: &str, shape: &[i64]) -> Tensor {
    let mut random = SplitMix64::named(name, 7);
    let values: Vec<f32> = (0..shape.iter().product::<i64>())
        .map(|_| random.signed_unit() as f32)
        .collect();
    Tensor::from_slice(&values).view(shape)
}

/// A convolution and what it gets.
struct Case {
    weight: Tensor,
    bias: Tensor,
    x: Tensor,
    beside: Option<Tensor>,
}

impl Case {
    /// `x` is `(pictures, channels, height, width)`.
    fn new(x: [i64; 4], outputs: i64, beside: bool) -> Self {
        let [pictures, inputs, height, width] = x;
        Self {
            weight: numbers("weight", &[outputs, inputs, 3, 3]),
            bias: numbers("bias", &[outputs]),
            x: numbers("x", &x).relu(),
            beside: beside.then(|| numbers("beside", &[pictures, outputs, height, width])),
        }
    }

    fn ours(&self) -> Result<Tensor, TchError> {
        let convolution = Winograd::new(&self.weight, &self.bias)?;
        let mut workspace = Workspace::default();
        // What is left of others is no part of an answer.
        let other = workspace.plane_of(&self.x.full_like(f64::NAN))?;
        let of_other = convolution.apply(&other, None, &mut workspace)?;
        workspace.give_back(other);
        workspace.give_back(of_other);
        let x = workspace.plane_of(&self.x)?;
        let beside = self.beside.as_ref();
        let beside = beside
            .map(|beside| workspace.plane_of(beside))
            .transpose()?;
        convolution
            .apply(&x, beside.as_ref(), &mut workspace)?
            .tensor()
    }

    fn expected(&self, kind: Kind) -> Tensor {
        let [weight, bias, x] = [&self.weight, &self.bias, &self.x].map(|x| x.to_kind(kind));
        let sum = x.conv2d(&weight, Some(&bias), [1, 1], [1, 1], [1, 1], 1);
        match &self.beside {
            Some(beside) => (sum + beside).relu(),
            None => sum.relu(),
        }
    }
}

/// How far `actual` is from `expected`, of the greatest number in the latter.
fn off(actual: &Tensor, expected: &Tensor) -> f64 {
    assert_eq!(actual.size(), expected.size());
    let scale = expected.abs().max().double_value(&[]);
    assert!(scale > 0.1, "it says something: {scale}");
    (actual - expected).abs().max().double_value(&[]) / scale
}

#[track_caller]
fn check(x: [i64; 4], outputs: i64, beside: bool) {
    let case = Case::new(x, outputs, beside);
    let ours = case.ours().unwrap();
    let expected = case.expected(Kind::Double);
    let library = off(&case.expected(Kind::Float), &expected);
    let off = off(&ours, &expected);
    eprintln!("{x:?} ours {off:.1e} library {library:.1e}");
    assert!(
        off <= ROUNDING,
        "{x:?}: off by {off:e}, library {library:e}"
    );
}

#[test]
fn pictures_of_whole_tiles() {
    check([1, 16, 4, 4], 32, false);
    check([1, 64, 24, 16], 64, true);
}

#[test]
fn pictures_that_end_within_a_tile() {
    check([1, 16, 1, 1], 32, true);
    check([1, 32, 5, 7], 64, false);
    check([1, 48, 10, 3], 32, true);
}

#[test]
fn several_pictures_and_blocks() {
    check([3, 16, 22, 34], 32, true);
    check([2, 96, 33, 37], 64, false);
}

#[test]
fn many_channels() {
    check([1, 512, 6, 9], 96, true);
}

#[test]
fn same_input_gives_same_bits() {
    let case = Case::new([1, 32, 13, 18], 32, true);
    assert_eq!(case.ours().unwrap(), case.ours().unwrap());
}

#[test]
fn what_is_not_a_number_stays_so() {
    let mut case = Case::new([1, 16, 9, 9], 32, false);
    let _ = case.x.get(0).get(3).get(4).get(4).fill_(f64::NAN);
    let seen = case.ours().unwrap().isnan();
    // Within reach of the kernel in the library's way, within reach of the tile in ours.
    let nearest = seen.narrow(2, 3, 3).narrow(3, 3, 3).all();
    assert!(bool::try_from(nearest).unwrap());
    case.x = Tensor::zeros_like(&case.x);
    assert!(!bool::try_from(case.ours().unwrap().isnan().any()).unwrap());
}

#[test]
fn shapes_that_do_not_fit_are_refused() {
    for shape in [[32, 16, 5, 5], [31, 16, 3, 3], [32, 15, 3, 3]] {
        let weight = Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        let bias = Tensor::zeros([shape[0]], (Kind::Float, Device::Cpu));
        assert!(Winograd::new(&weight, &bias).is_err(), "{shape:?}");
    }
    let mut case = Case::new([1, 16, 8, 8], 32, true);
    case.beside = Some(numbers("beside", &[1, 32, 8, 9]));
    assert!(case.ours().is_err());
    case.beside = None;
    case.weight = numbers("weight", &[32, 32, 3, 3]);
    assert!(case.ours().is_err());
}

#[test]
fn it_pays_where_little_is_thrown_away() {
    for (height, width, expected) in [
        (128, 128, true),
        (16, 16, true),
        (15, 20, true),
        (7, 7, false),
        (4, 6, false),
        (1, 200, false),
    ] {
        assert_eq!(Winograd::pays(height, width), expected, "{height}x{width}");
    }
}
