//! DP3's normaliser: every number's range in the dataset to -1 to 1.
//!
//! `scale = 2 / (max - min)`, `offset = -1 - scale * min`, so `min` becomes -1 and `max` 1.
//! Diffusion clamps samples to that range, which is why it takes limits and not deviations.

use tch::{TchError, Tensor};

/// Ranges below this are taken for constants.
const RANGE_MIN: f64 = 1e-4;

/// Takes a feature from its limits in the dataset to -1 to 1 over its last dimension, and back.
///
/// A number that (almost) never changes is only shifted, its least value to zero.
#[derive(Debug)]
pub struct LimitsNormaliser {
    /// `(dimensions)`; 1 for a constant.
    scale: Tensor,
    /// `(dimensions)`.
    offset: Tensor,
}

/// Why limits are of no use.
#[derive(Debug, thiserror::Error)]
pub enum LimitsError {
    /// There are not as many least as greatest values.
    #[error("{min} least and {max} greatest values")]
    Count {
        /// Least values.
        min: usize,
        /// Greatest values.
        max: usize,
    },
    /// A least value is above the greatest, or either is not finite.
    #[error("dimension {dimension} goes from {min} to {max}")]
    Order {
        /// Which number of the feature.
        dimension: usize,
        /// Its least value.
        min: f32,
        /// Its greatest value.
        max: f32,
    },
    /// The network library failed.
    #[error(transparent)]
    Torch(#[from] TchError),
}

impl LimitsNormaliser {
    /// The normaliser for these limits, on the CPU.
    ///
    /// # Errors
    /// [`LimitsError`] naming the dimension that is out of order.
    pub fn new(min: &[f32], max: &[f32]) -> Result<Self, LimitsError> {
        if min.len() != max.len() {
            let (min, max) = (min.len(), max.len());
            return Err(LimitsError::Count { min, max });
        }
        for (dimension, (&min, &max)) in min.iter().zip(max).enumerate() {
            if !(min.is_finite() && max.is_finite() && min <= max) {
                return Err(LimitsError::Order {
                    dimension,
                    min,
                    max,
                });
            }
        }
        let (min, max) = (Tensor::f_from_slice(min)?, Tensor::f_from_slice(max)?);
        let range = max.f_sub(&min)?;
        let constant = range.f_lt(RANGE_MIN)?;
        let scale = range.f_masked_fill(&constant, 2.0)?.f_reciprocal()?;
        let scale = scale.f_mul_scalar(2.0)?;
        let centred = scale.f_mul(&min)?.f_add_scalar(1.0)?;
        let offset = min.f_where_self(&constant, &centred)?.f_neg()?;
        Ok(Self { scale, offset })
    }

    /// The same on `device`.
    ///
    /// # Errors
    /// The network library's.
    pub fn to_device(&self, device: tch::Device) -> Result<Self, TchError> {
        Ok(Self {
            scale: self.scale.f_to_device(device)?,
            offset: self.offset.f_to_device(device)?,
        })
    }

    /// `x * scale + offset`.
    ///
    /// # Errors
    /// The network library's, if the last dimension does not fit.
    pub fn apply(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_mul(&self.scale)?.f_add(&self.offset)
    }

    /// `(x - offset) / scale`.
    ///
    /// # Errors
    /// The network library's, if the last dimension does not fit.
    pub fn invert(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_sub(&self.offset)?.f_div(&self.scale)
    }
}

#[cfg(test)]
mod tests {
    use super::LimitsNormaliser;
    use tch::Tensor;

    fn applied(normaliser: &LimitsNormaliser, x: &[f32]) -> Vec<f32> {
        let x = Tensor::from_slice(x);
        Vec::try_from(normaliser.apply(&x).unwrap()).unwrap()
    }

    #[test]
    fn limits_become_one_and_constants_are_shifted() {
        let normaliser = LimitsNormaliser::new(&[-3.0, 2.0, 5.0], &[5.0, 2.5, 5.00001]).unwrap();
        assert_eq!(applied(&normaliser, &[-3.0, 2.0, 5.0]), [-1.0, -1.0, 0.0]);
        assert_eq!(applied(&normaliser, &[5.0, 2.5, 5.5]), [1.0, 1.0, 0.5]);
        let back = normaliser
            .invert(&Tensor::from_slice(&[0.0_f32, 0.5, 0.5]))
            .unwrap();
        assert_eq!(Vec::<f32>::try_from(back).unwrap(), [1.0, 2.375, 5.5]);
    }

    #[test]
    fn useless_limits_are_refused_by_dimension() {
        let refused =
            |min: &[f32], max: &[f32]| LimitsNormaliser::new(min, max).unwrap_err().to_string();
        assert_eq!(
            refused(&[0.0, 2.0], &[1.0, 1.0]),
            "dimension 1 goes from 2 to 1"
        );
        assert_eq!(
            refused(&[f32::NAN], &[1.0]),
            "dimension 0 goes from NaN to 1"
        );
        assert_eq!(
            refused(&[0.0], &[f32::INFINITY]),
            "dimension 0 goes from 0 to inf"
        );
        assert_eq!(refused(&[0.0], &[]), "1 least and 0 greatest values");
    }
}
