//! The same numbers as the library's plain convolutions in double precision, to rounding, whatever
//! the vectors' width.

use tch::{Device, Kind, TchError, Tensor};

use super::{Direct, Plane, Size, Stem, Steps, Winograd, Workspace, shape_of};
use crate::layers::aligned::Aligned;
use crate::layers::seeded::numbers;
use crate::layers::vectors::Processor;

/// Of the greatest number in an answer. Seen here: tiles up to 1.6e-6, taps 7.7e-7, the stem
/// 4.6e-7, the library 5.7e-7.
const ROUNDING: f64 = 2e-6;

fn plane_of(x: &Tensor) -> Plane {
    let [batch, channels, height, width] = shape_of(x).unwrap();
    let last = x.permute([0, 2, 3, 1]).contiguous().view([-1]);
    Plane {
        values: Aligned::of(&Vec::<f32>::try_from(&last).unwrap()),
        size: Size {
            batch,
            height,
            width,
            channels,
        },
    }
}

/// As `(batch, channels, height, width)`.
fn tensor_of(plane: &Plane) -> Tensor {
    let size = plane.size;
    let shape = [size.batch, size.height, size.width, size.channels];
    let rows = plane.rows().unwrap();
    rows.view(shape.map(|n| i64::try_from(n).unwrap()))
        .permute([0, 3, 1, 2])
}

#[derive(Clone, Copy)]
enum Way {
    Tiles,
    Taps(Steps),
    Stem,
}

const SAME: Steps = Steps {
    stride: 1,
    padding: 1,
};
const HALF: Steps = Steps {
    stride: 2,
    padding: 1,
};
const PICKED: Steps = Steps {
    stride: 2,
    padding: 0,
};

/// A convolution and what it gets.
struct Case {
    way: Way,
    weight: Tensor,
    bias: Tensor,
    x: Tensor,
    beside: Option<Tensor>,
}

impl Case {
    /// `x` is `(batch, channels, height, width)`.
    fn new(way: Way, x: [i64; 4], outputs: i64) -> Self {
        let side = match way {
            Way::Stem => 7,
            Way::Taps(Steps { padding: 0, .. }) => 1,
            Way::Tiles | Way::Taps(_) => 3,
        };
        let seen = numbers("x", &x);
        Self {
            way,
            weight: numbers("weight", &[outputs, x[1], side, side]),
            bias: numbers("bias", &[outputs]),
            // As in the network, where a rectifier comes before all but the first.
            x: match way {
                Way::Stem => seen,
                Way::Tiles | Way::Taps(_) => seen.relu(),
            },
            beside: None,
        }
    }

    fn beside(mut self) -> Self {
        self.beside = Some(numbers("beside", &self.expected(Kind::Float).size()));
        self
    }

    fn apply(&self, x: &Tensor, workspace: &mut Workspace) -> Result<Plane, TchError> {
        let beside = self.beside.as_ref().map(plane_of);
        let beside = beside.as_ref();
        match self.way {
            Way::Tiles => {
                Winograd::new(&self.weight, &self.bias)?.apply(&plane_of(x), beside, workspace)
            }
            Way::Taps(steps) => Direct::new(&self.weight, &self.bias, steps, true)?.apply(
                &plane_of(x),
                beside,
                workspace,
            ),
            Way::Stem => Stem::new(&self.weight, &self.bias)?.apply(x, workspace),
        }
    }

    fn ours(&self, processor: Processor) -> Result<Tensor, TchError> {
        let mut workspace = Workspace::of(processor);
        // What is left of others is no part of an answer.
        let other = self.apply(&self.x.full_like(f64::NAN), &mut workspace)?;
        workspace.give_back(other);
        Ok(tensor_of(&self.apply(&self.x, &mut workspace)?))
    }

    fn expected(&self, kind: Kind) -> Tensor {
        let [weight, bias, x] = [&self.weight, &self.bias, &self.x].map(|x| x.to_kind(kind));
        let (stride, padding) = match self.way {
            Way::Tiles => (1, 1),
            Way::Taps(Steps { stride, padding }) => (stride, padding),
            Way::Stem => (2, 3),
        };
        let [stride, padding] = [stride, padding].map(|n| [i64::try_from(n).unwrap(); 2]);
        let sum = x.conv2d(&weight, Some(&bias), stride, padding, [1, 1], 1);
        match (&self.beside, self.way) {
            (Some(beside), _) => (sum + beside).relu(),
            (None, Way::Stem) => sum.relu().max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false),
            (None, _) => sum.relu(),
        }
    }

    #[track_caller]
    fn check(&self) {
        let processor = Processor::found().expect("the tests need AVX2");
        let ours = self.ours(processor).unwrap();
        let expected = self.expected(Kind::Double);
        let library = off(&self.expected(Kind::Float), &expected);
        let off = off(&ours, &expected);
        assert!(
            off <= ROUNDING,
            "off by {off:e}, the library by {library:e}"
        );
        for processor in Processor::all() {
            assert_eq!(
                self.ours(processor).unwrap(),
                ours,
                "{processor:?} gives other bits"
            );
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

#[test]
fn pictures_of_whole_tiles() {
    Case::new(Way::Tiles, [1, 16, 4, 4], 32).check();
    Case::new(Way::Tiles, [1, 64, 24, 16], 64).beside().check();
}

#[test]
fn pictures_that_end_within_a_tile() {
    Case::new(Way::Tiles, [1, 16, 1, 1], 32).beside().check();
    Case::new(Way::Tiles, [1, 32, 5, 7], 64).check();
    Case::new(Way::Tiles, [1, 48, 10, 3], 32).beside().check();
}

#[test]
fn several_pictures_and_blocks() {
    Case::new(Way::Tiles, [3, 16, 22, 34], 32).beside().check();
    Case::new(Way::Tiles, [2, 96, 33, 37], 64).check();
}

#[test]
fn many_channels() {
    Case::new(Way::Tiles, [1, 512, 6, 9], 96).beside().check();
    Case::new(Way::Taps(HALF), [1, 256, 7, 9], 96).check();
}

#[test]
fn taps_of_any_stride() {
    Case::new(Way::Taps(SAME), [2, 16, 5, 7], 32)
        .beside()
        .check();
    Case::new(Way::Taps(HALF), [2, 16, 9, 6], 64).check();
    Case::new(Way::Taps(HALF), [1, 7, 1, 2], 32).check();
    Case::new(Way::Taps(PICKED), [2, 16, 9, 6], 64)
        .beside()
        .check();
    // Several blocks of rows.
    Case::new(Way::Taps(HALF), [1, 64, 70, 66], 32).check();
}

#[test]
fn the_first_layers_of_any_size() {
    for size in [[2, 3, 32, 48], [1, 3, 33, 19], [1, 3, 1, 1], [3, 3, 6, 70]] {
        Case::new(Way::Stem, size, 64).check();
    }
}

#[test]
fn what_is_not_a_number_stays_so() {
    let processor = Processor::found().unwrap();
    for (way, channels) in [
        (Way::Tiles, 16),
        (Way::Taps(SAME), 16),
        (Way::Taps(HALF), 16),
        (Way::Stem, 3),
    ] {
        let case = Case::new(way, [1, channels, 9, 9], 32);
        let _ = case.x.get(0).get(2).get(4).get(4).fill_(f64::NAN);
        // Within reach of the kernel in the library's way, and perhaps further in ours.
        let expected = case.expected(Kind::Float).isnan();
        assert!(bool::try_from(expected.any()).unwrap());
        let seen = case.ours(processor).unwrap().isnan();
        assert_eq!(seen.logical_and(&expected), expected);
    }
}

#[test]
fn shapes_that_do_not_fit_are_refused() {
    let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
    for shape in [
        [32, 16, 5, 5],
        [31, 16, 3, 3],
        [32, 15, 3, 3],
        [32, 0, 3, 3],
    ] {
        assert!(Winograd::new(&zeros(&shape), &zeros(&shape[..1])).is_err());
    }
    for shape in [
        [31, 16, 3, 3],
        [32, 16, 3, 1],
        [32, 16, 1, 1],
        [32, 0, 3, 3],
    ] {
        assert!(Direct::new(&zeros(&shape), &zeros(&shape[..1]), HALF, true).is_err());
    }
    for shape in [[31, 3, 7, 7], [32, 1, 7, 7], [32, 3, 3, 3]] {
        assert!(Stem::new(&zeros(&shape), &zeros(&shape[..1])).is_err());
    }
    for outputs in [31, 33] {
        let bias = zeros(&[outputs]);
        assert!(Winograd::new(&zeros(&[32, 16, 3, 3]), &bias).is_err());
        assert!(Direct::new(&zeros(&[32, 16, 3, 3]), &bias, HALF, true).is_err());
        assert!(Stem::new(&zeros(&[32, 3, 7, 7]), &bias).is_err());
    }
    let processor = Processor::found().unwrap();
    for way in [Way::Tiles, Way::Taps(HALF)] {
        let mut case = Case::new(way, [1, 16, 8, 8], 32);
        case.beside = Some(numbers("beside", &[1, 32, 8, 9]));
        assert!(case.ours(processor).is_err());
        case.beside = None;
        case.weight = numbers("weight", &[32, 32, 3, 3]);
        let error = case.ours(processor).unwrap_err().to_string();
        assert!(error.contains("channels: 16 }") && error.contains("of 32 channels"));
        assert!(error.len() < 200, "{error}");
    }
    let stem = Case::new(Way::Stem, [1, 3, 8, 8], 32);
    let grey = numbers("x", &[1, 1, 8, 8]);
    assert!(stem.apply(&grey, &mut Workspace::of(processor)).is_err());
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
