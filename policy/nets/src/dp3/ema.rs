//! The moving average of a network's parameters, which is what DP3 evaluates.
//!
//! `average = d * average + (1 - d) * parameters`; after `n` earlier updates `d = 1 - n^-0.75`, at
//! most 0.9999, and 0 in the first two updates.

use std::collections::BTreeMap;

use tch::{TchError, Tensor};

use crate::parameters::Parameters;

/// A moving average that forgets its beginning: the more updates, the slower it moves.
#[derive(Debug)]
pub struct MovingAverage {
    tensors: BTreeMap<String, Tensor>,
    /// How often [`Self::update`] was called.
    updates: u64,
}

impl MovingAverage {
    /// The greatest share that stays at an update.
    pub const DECAY_MAX: f64 = 0.9999;

    /// How fast the share that stays grows.
    pub const POWER: f64 = 0.75;

    /// Starts with a copy of `parameters`.
    ///
    /// # Errors
    /// The network library's.
    pub fn new(parameters: &Parameters) -> Result<Self, TchError> {
        let tensors = tch::no_grad(|| {
            parameters
                .iter()
                .map(|(key, tensor)| Ok((key.to_owned(), tensor.f_detach_copy()?)))
                .collect::<Result<_, TchError>>()
        })?;
        Ok(Self {
            tensors,
            updates: 0,
        })
    }

    /// The share of the average that stays at the update after `updates` others.
    #[must_use]
    pub fn decay(updates: u64) -> f64 {
        Self::decay_with(updates, Self::POWER)
    }

    /// The same with another power.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^52")]
    pub fn decay_with(updates: u64, power: f64) -> f64 {
        if updates <= 1 {
            return 0.0;
        }
        (1.0 - (updates as f64).powf(-power)).clamp(0.0, Self::DECAY_MAX)
    }

    /// Moves towards `parameters`; what training leaves alone is taken over as it is.
    ///
    /// # Errors
    /// The network library's, if these are another network's parameters.
    pub fn update(&mut self, parameters: &Parameters) -> Result<(), TchError> {
        let decay = Self::decay(self.updates);
        self.updates += 1;
        tch::no_grad(|| {
            for (key, tensor) in parameters.iter() {
                let Some(average) = self.tensors.get_mut(key) else {
                    return Err(TchError::Shape(format!("no average of {key}")));
                };
                if parameters.is_trainable(key) {
                    let new = tensor.f_mul_scalar(1.0 - decay)?;
                    let _ = average.f_mul_scalar_(decay)?.f_add_(&new)?;
                } else {
                    average.f_copy_(tensor)?;
                }
            }
            Ok(())
        })
    }

    /// The average by key, and how many updates it has seen.
    #[must_use]
    pub fn into_parts(self) -> (BTreeMap<String, Tensor>, u64) {
        (self.tensors, self.updates)
    }
}

#[cfg(test)]
mod tests {
    use super::MovingAverage;
    use crate::parameters::{Init, ParameterSource};
    use tch::{Device, Tensor};

    #[test]
    fn the_share_that_stays_grows_as_published() {
        for (updates, decay) in [
            (0, 0.0_f64),
            (1, 0.0),
            (10_000_000, MovingAverage::DECAY_MAX),
        ] {
            let bits = MovingAverage::decay(updates).to_bits();
            assert_eq!(bits, decay.to_bits(), "after {updates}");
        }
        // 1 - 2^-0.75 and 1 - 10001^-0.75.
        assert!((MovingAverage::decay(2) - 0.405_396_442_498_639).abs() < 1e-12);
        assert!((MovingAverage::decay(10_001) - 0.999_000_074_990).abs() < 1e-9);
    }

    #[test]
    fn parameters_are_averaged_and_the_rest_is_copied() {
        let mut source = ParameterSource::seeded(0, Device::Cpu);
        let trained = source.trainable("a", &[1], &Init::Constant(0.0)).unwrap();
        let fixed = source.fixed("b", &[1], &Init::Constant(0.0)).unwrap();
        let parameters = source.finish().unwrap();
        let mut average = MovingAverage::new(&parameters).unwrap();
        let mut expected = 0.0;
        for (update, value) in [3.0, -1.0, 5.0, 2.0].into_iter().enumerate() {
            let _ = trained.shallow_clone().fill_(value);
            let _ = fixed.shallow_clone().fill_(value);
            average.update(&parameters).unwrap();
            let decay = MovingAverage::decay(u64::try_from(update).unwrap());
            expected = decay * expected + (1.0 - decay) * value;
        }
        let (tensors, updates) = average.into_parts();
        let value = |tensor: &Tensor| tensor.double_value(&[0]);
        assert_eq!(updates, 4);
        assert!((value(&tensors["a"]) - expected).abs() < 1e-6);
        assert_eq!(tensors["b"], fixed);
    }
}
