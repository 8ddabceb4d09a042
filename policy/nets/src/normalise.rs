//! Statistics of states and actions, the normalisation with them, and that of images.

use tch::{Kind, TchError, Tensor};

/// Mean of ImageNet's red, green and blue, in 0 to 1.
pub const IMAGENET_MEAN: [f32; 3] = [0.485, 0.456, 0.406];

/// Standard deviation of ImageNet's red, green and blue, in 0 to 1.
pub const IMAGENET_STD: [f32; 3] = [0.229, 0.224, 0.225];

/// Least deviation of a length, m: a tenth of a millimetre, what the arm repeats to. The 1e-2 of
/// the original ACT suits radians and metres of a whole arm; here, chunks of millimetres would
/// vanish in it.
pub const LENGTH_STD_MIN_M: f64 = 1e-4;

/// Least deviation of an angle, rad: a joint that demonstrations leave alone must not turn encoder
/// noise into a signal.
pub const ANGLE_STD_MIN_RAD: f64 = 5e-3;

/// Least deviations of one arm's `observation.state`: yaw, pitch, insertion, roll, wrist pitch,
/// wrist yaw, jaw.
pub const STATE_STD_MIN: [f64; 7] = {
    let (length, angle) = (LENGTH_STD_MIN_M, ANGLE_STD_MIN_RAD);
    [angle, angle, length, angle, angle, angle, angle]
};

/// Least deviations of one arm's action: translation, rotation vector, jaw.
pub const ACTION_STD_MIN: [f64; 7] = {
    let (length, angle) = (LENGTH_STD_MIN_M, ANGLE_STD_MIN_RAD);
    [length, length, length, angle, angle, angle, angle]
};

/// Mean, deviation and range of one feature, a number each per dimension.
///
/// LeRobot's `MEAN_STD` uses mean and deviation; DP3's limits use the range. Files without a range
/// leave it empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// Mean.
    pub mean: Vec<f32>,
    /// Standard deviation (unbiased), not below the floor given for it.
    pub std: Vec<f32>,
    /// Least value.
    pub min: Vec<f32>,
    /// Greatest value.
    pub max: Vec<f32>,
}

impl Statistics {
    /// Statistics of `samples`, the deviations not below `std_min`. `None` without samples.
    ///
    /// Two passes in double precision. NaN in a sample makes the mean NaN, which [`Self::defect`]
    /// names.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "networks compute in single precision"
    )]
    #[expect(
        clippy::cast_precision_loss,
        reason = "counts of samples stay far below 2^52"
    )]
    pub fn of<const N: usize>(
        samples: impl Iterator<Item = [f64; N]> + Clone,
        std_min: [f64; N],
    ) -> Option<Self> {
        let count = samples.clone().count();
        if count == 0 {
            return None;
        }
        let (mut sum, mut min, mut max) = ([0.0; N], [f64::INFINITY; N], [f64::NEG_INFINITY; N]);
        for sample in samples.clone() {
            for (axis, value) in sample.into_iter().enumerate() {
                sum[axis] += value;
                min[axis] = value.min(min[axis]);
                max[axis] = value.max(max[axis]);
            }
        }
        let mean = sum.map(|sum| sum / count as f64);
        let mut squares = [0.0; N];
        for sample in samples {
            for (axis, value) in sample.into_iter().enumerate() {
                squares[axis] += (value - mean[axis]) * (value - mean[axis]);
            }
        }
        let freedom = count.saturating_sub(1).max(1) as f64;
        let std = (0..N)
            .map(|axis| (squares[axis] / freedom).sqrt().max(std_min[axis]) as f32)
            .collect();
        let narrow = |values: [f64; N]| values.iter().map(|value| *value as f32).collect();
        Some(Self {
            mean: narrow(mean),
            std,
            min: narrow(min),
            max: narrow(max),
        })
    }

    /// Those of several features as of one, their dimensions one after another.
    #[must_use]
    pub fn joined(parts: &[Self]) -> Self {
        let join = |of: fn(&Self) -> &[f32]| parts.iter().flat_map(of).copied().collect();
        Self {
            mean: join(|part| &part.mean),
            std: join(|part| &part.std),
            min: join(|part| &part.min),
            max: join(|part| &part.max),
        }
    }

    /// What makes these statistics useless for `dims` dimensions, if anything does.
    #[must_use]
    pub fn defect(&self, dims: usize) -> Option<String> {
        if self.mean.len() != dims || self.std.len() != dims {
            return Some(format!(
                "has {} means and {} deviations, not {dims}",
                self.mean.len(),
                self.std.len()
            ));
        }
        for (axis, (mean, std)) in self.mean.iter().zip(&self.std).enumerate() {
            if !mean.is_finite() || mean.abs() > GREATEST {
                return Some(format!(
                    "mean of dimension {axis} is {mean}, outside [-{GREATEST}, {GREATEST}]"
                ));
            }
            // Below this, single precision cannot tell a deviation from none.
            if !(*std > 1e-8 && *std <= GREATEST) {
                return Some(format!(
                    "deviation of dimension {axis} is {std}, outside (1e-8, {GREATEST}]"
                ));
            }
        }
        None
    }

    /// A normaliser on the CPU. Takes statistics without a [`Self::defect`].
    #[must_use]
    pub fn normaliser(&self) -> Normaliser {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "statistics are in single precision"
        )]
        let divisors: Vec<f32> = self.std.iter().map(|std| std + EPS as f32).collect();
        Normaliser {
            mean: Tensor::from_slice(&self.mean),
            std: Tensor::from_slice(&self.std),
            divisor: Tensor::from_slice(&divisors),
        }
    }
}

/// No joint, tip or jaw has been, or could be, as many metres or radians away.
const GREATEST: f32 = 100.0;

/// What LeRobot adds to a deviation before it divides by it (`eps` in the processor's file).
pub(crate) const EPS: f64 = 1e-8;

/// Takes a feature to mean 0 and deviation 1 over its last dimension, and back.
#[derive(Debug)]
pub struct Normaliser {
    /// `(dimensions)`.
    mean: Tensor,
    std: Tensor,
    /// `std + 1e-8`, added once.
    divisor: Tensor,
}

impl Normaliser {
    /// `(x - mean) / (std + 1e-8)`, as LeRobot's processor does, which has no such term on the way
    /// back.
    ///
    /// # Errors
    /// The network library's, if the last dimension does not fit.
    pub fn apply(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_sub(&self.mean)?.f_div(&self.divisor)
    }

    /// `x * std + mean`.
    ///
    /// # Errors
    /// The network library's, if the last dimension does not fit.
    pub fn invert(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_mul(&self.std)?.f_add(&self.mean)
    }
}

/// Takes colour bytes to what the backbone expects: 0 to 1, then ImageNet's mean and deviation.
/// `(byte / 255 - mean) / std` as one multiplication and one addition.
#[derive(Debug)]
pub struct ImageNormaliser {
    /// `1 / (255 std)`, `(3, 1, 1)`.
    scale: Tensor,
    /// `-mean / std`, `(3, 1, 1)`.
    shift: Tensor,
}

impl ImageNormaliser {
    /// A normaliser with ImageNet's statistics for images on `device`.
    ///
    /// # Errors
    /// The network library's.
    pub fn imagenet(device: tch::Device) -> Result<Self, TchError> {
        let std = Tensor::f_from_slice(&IMAGENET_STD)?.f_view([3, 1, 1])?;
        let mean = Tensor::f_from_slice(&IMAGENET_MEAN)?.f_view([3, 1, 1])?;
        let scale = std.f_mul_scalar(255.0)?.f_reciprocal()?;
        let shift = mean.f_div(&std)?.f_neg()?;
        Ok(Self {
            scale: scale.f_to_device(device)?,
            shift: shift.f_to_device(device)?,
        })
    }

    /// Bytes `(.., height, width, 3)` to floats `(.., 3, height, width)`; the channels stay last in
    /// memory.
    ///
    /// # Errors
    /// The network library's, if there are not three channels.
    pub fn apply(&self, bytes: &Tensor) -> Result<Tensor, TchError> {
        let planes = bytes.f_movedim_int(-1, -3)?.f_to_kind(Kind::Float)?;
        self.shift.f_addcmul(&planes, &self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::{ImageNormaliser, Statistics};
    use tch::{Device, Kind, Tensor};

    #[test]
    fn deviation_is_unbiased_and_floored() {
        let samples = [[1.0, 5.0], [2.0, 5.0], [3.0, 5.0]];
        let statistics = Statistics::of(samples.into_iter(), [1e-4, 1e-2]).unwrap();
        assert_eq!(statistics.mean, [2.0, 5.0]);
        assert_eq!(statistics.std, [1.0, 1e-2]);
        assert_eq!((statistics.min[0], statistics.max[0]), (1.0, 3.0));
    }

    #[test]
    fn zero_and_nan_are_defects() {
        let good = Statistics {
            mean: vec![0.0],
            std: vec![1.0],
            min: vec![],
            max: vec![],
        };
        assert_eq!(good.defect(1), None);
        assert!(
            Statistics {
                std: vec![0.0],
                ..good.clone()
            }
            .defect(1)
            .unwrap()
            .contains("deviation")
        );
        assert!(
            Statistics {
                std: vec![f32::NAN],
                ..good.clone()
            }
            .defect(1)
            .is_some()
        );
        assert!(
            Statistics {
                mean: vec![f32::NAN],
                ..good.clone()
            }
            .defect(1)
            .unwrap()
            .contains("mean")
        );
        assert!(good.defect(2).is_some());
    }

    #[test]
    fn a_small_deviation_is_divided_by_as_lerobot_does() {
        let statistics = Statistics {
            mean: vec![0.0],
            std: vec![1e-7],
            min: vec![],
            max: vec![],
        };
        let normaliser = statistics.normaliser();
        let apply = |x: f32| {
            let x = Tensor::from_slice(&[x]);
            f32::try_from(normaliser.apply(&x).unwrap()).unwrap()
        };
        assert!((apply(1.1e-7) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn normalising_and_back_is_the_identity() {
        let statistics = Statistics {
            mean: vec![1.0, -2.0],
            std: vec![0.5, 4.0],
            min: vec![],
            max: vec![],
        };
        let normaliser = statistics.normaliser();
        let x = Tensor::from_slice(&[3.0_f32, 6.0]).view([1, 2]);
        let normalised = normaliser.apply(&x).unwrap();
        assert_eq!(
            Vec::<f32>::try_from(normalised.flatten(0, -1)).unwrap(),
            [4.0, 2.0]
        );
        assert_eq!(normaliser.invert(&normalised).unwrap(), x);
    }

    #[test]
    fn white_is_normalised_as_imagenet_has_it() {
        let white = Tensor::full([1, 2, 2, 3], 255, (Kind::Uint8, Device::Cpu));
        let image = ImageNormaliser::imagenet(Device::Cpu)
            .unwrap()
            .apply(&white)
            .unwrap();
        assert_eq!(image.size(), [1, 3, 2, 2]);
        let red = image.double_value(&[0, 0, 1, 1]);
        assert!((red - (1.0 - 0.485) / 0.229).abs() < 1e-5, "{red}");
    }
}
