//! Where the parameters of a network come from: drawn from a seed, or given by a checkpoint, by
//! key.
//!
//! A network's constructor asks for each tensor by key, shape and initial distribution; so building
//! from a seed, loading and checking a checkpoint are the same code, and a tensor that nobody asked
//! for is found. Each key draws from a stream of its own, so the order of building changes no
//! number.

use std::collections::{BTreeMap, BTreeSet};

use tch::{Device, Kind, TchError, Tensor};

use hal::random::SplitMix64;

/// How a parameter starts when nothing is loaded.
#[derive(Clone, Debug)]
pub enum Init {
    /// All the same value.
    Constant(f32),
    /// Even in plus or minus the bound.
    Uniform(f64),
    /// Normal with mean 0 and this deviation.
    Normal(f64),
    /// Exactly these values, row-major.
    Table(Vec<f32>),
}

impl Init {
    /// Xavier's bound for a matrix of `rows` outputs and `columns` inputs.
    #[must_use]
    pub fn xavier(rows: i64, columns: i64) -> Self {
        Self::Uniform((6.0 / count(rows + columns)).sqrt())
    }

    /// The bound that PyTorch gives weights and biases of a layer with `fan_in` inputs.
    #[must_use]
    pub fn fan_in(fan_in: i64) -> Self {
        Self::Uniform(1.0 / count(fan_in).sqrt())
    }

    /// He initialisation of a layer before ReLU, by its `fan_out` outputs.
    #[must_use]
    pub fn he(fan_out: i64) -> Self {
        Self::Normal((2.0 / count(fan_out)).sqrt())
    }

    /// Numbers for the tensor `key`, row-major.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "networks compute in single precision"
    )]
    fn draw(&self, key: &str, seed: u64, length: usize) -> Vec<f32> {
        let mut random = SplitMix64::named(key, seed);
        match self {
            Self::Constant(value) => vec![*value; length],
            Self::Uniform(bound) => (0..length)
                .map(|_| (bound * random.signed_unit()) as f32)
                .collect(),
            Self::Normal(deviation) => (0..length)
                .map(|_| (deviation * random.normal()) as f32)
                .collect(),
            Self::Table(values) => values.clone(),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "sizes of layers are small")]
const fn count(value: i64) -> f64 {
    value as f64
}

/// Why a network could not get its parameters.
#[derive(Debug, thiserror::Error)]
pub enum ParameterError {
    /// The checkpoint lacks a tensor.
    #[error("tensor {key} is missing")]
    Missing {
        /// The tensor.
        key: String,
    },
    /// A tensor has another shape than the network.
    #[error("tensor {key} has shape {actual:?}, the network needs {expected:?}")]
    Shape {
        /// The tensor.
        key: String,
        /// What the network needs.
        expected: Vec<i64>,
        /// What is there.
        actual: Vec<i64>,
    },
    /// The checkpoint has a tensor that the network has no use for.
    #[error("tensor {key} belongs to no part of the network")]
    Unexpected {
        /// The tensor.
        key: String,
    },
    /// The network library failed.
    #[error(transparent)]
    Torch(#[from] TchError),
}

impl ParameterError {
    /// The same of the tensor that `name` makes of the key.
    pub(crate) fn with_keys(self, name: impl Fn(&str) -> String) -> Self {
        match self {
            Self::Missing { key } => Self::Missing { key: name(&key) },
            Self::Shape {
                key,
                expected,
                actual,
            } => Self::Shape {
                key: name(&key),
                expected,
                actual,
            },
            Self::Unexpected { key } => Self::Unexpected { key: name(&key) },
            Self::Torch(error) => Self::Torch(error),
        }
    }
}

/// Hands parameters to the layers of a network while it is built, and remembers them by key.
#[derive(Debug)]
pub struct ParameterSource {
    origin: Origin,
    /// By key; they share their memory with the network's.
    handed_out: BTreeMap<String, Tensor>,
    /// Keys of those that training changes.
    trainable: BTreeSet<String>,
}

/// Drawn anew, or what a checkpoint holds.
#[derive(Debug)]
enum Origin {
    Seed { seed: u64, device: Device },
    Given(BTreeMap<String, Tensor>),
}

impl ParameterSource {
    /// Fresh parameters on `device`: each key has its own stream of numbers under `seed`.
    #[must_use]
    pub const fn seeded(seed: u64, device: Device) -> Self {
        Self::from_origin(Origin::Seed { seed, device })
    }

    /// The given tensors, used as they are (not copied).
    #[must_use]
    pub const fn given(tensors: BTreeMap<String, Tensor>) -> Self {
        Self::from_origin(Origin::Given(tensors))
    }

    const fn from_origin(origin: Origin) -> Self {
        Self {
            origin,
            handed_out: BTreeMap::new(),
            trainable: BTreeSet::new(),
        }
    }

    /// Whether tensors whose key starts with `prefix` can be had.
    #[must_use]
    pub fn offers(&self, prefix: &str) -> bool {
        match &self.origin {
            Origin::Seed { .. } => true,
            Origin::Given(tensors) => tensors
                .range(prefix.to_owned()..)
                .next()
                .is_some_and(|(key, _)| key.starts_with(prefix)),
        }
    }

    /// A tensor that training changes.
    ///
    /// # Errors
    /// [`ParameterError::Missing`] or [`ParameterError::Shape`] if what is given does not fit.
    pub fn trainable(
        &mut self,
        key: &str,
        shape: &[i64],
        init: &Init,
    ) -> Result<Tensor, ParameterError> {
        self.trainable.insert(key.to_owned());
        self.fixed(key, shape, init)
    }

    /// A tensor that training leaves alone.
    ///
    /// # Errors
    /// As [`Self::trainable`].
    pub fn fixed(
        &mut self,
        key: &str,
        shape: &[i64],
        init: &Init,
    ) -> Result<Tensor, ParameterError> {
        let tensor = match &self.origin {
            Origin::Seed { seed, device } => {
                let length = shape.iter().product::<i64>();
                let values = init.draw(key, *seed, crate::dimension::length(length));
                Tensor::f_from_slice(&values)?
                    .f_reshape(shape)?
                    .f_to_device(*device)?
            }
            Origin::Given(tensors) => given(tensors, key, shape)?,
        };
        self.handed_out
            .insert(key.to_owned(), tensor.shallow_clone());
        Ok(tensor)
    }

    /// Ends the building: what was handed out.
    ///
    /// # Errors
    /// [`ParameterError::Unexpected`] if a given tensor is not used.
    pub fn finish(self) -> Result<Parameters, ParameterError> {
        if let Origin::Given(tensors) = &self.origin {
            let left = tensors
                .keys()
                .find(|key| !self.handed_out.contains_key(*key));
            if let Some(key) = left {
                return Err(ParameterError::Unexpected { key: key.clone() });
            }
        }
        Ok(Parameters {
            tensors: self.handed_out,
            trainable: self.trainable,
        })
    }
}

/// The tensor `key` among those given, which must have this shape.
fn given(
    tensors: &BTreeMap<String, Tensor>,
    key: &str,
    shape: &[i64],
) -> Result<Tensor, ParameterError> {
    let tensor = tensors.get(key).ok_or_else(|| ParameterError::Missing {
        key: key.to_owned(),
    })?;
    let actual = tensor.size();
    if actual == shape {
        return Ok(tensor.shallow_clone());
    }
    Err(ParameterError::Shape {
        key: key.to_owned(),
        expected: shape.to_vec(),
        actual,
    })
}

/// All tensors of a network by key.
#[derive(Debug)]
pub struct Parameters {
    tensors: BTreeMap<String, Tensor>,
    trainable: BTreeSet<String>,
}

impl Parameters {
    /// Every tensor with its key, in order of the keys.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.tensors
            .iter()
            .map(|(key, tensor)| (key.as_str(), tensor))
    }

    /// Whether training changes the tensor `key`.
    #[must_use]
    pub fn is_trainable(&self, key: &str) -> bool {
        self.trainable.contains(key)
    }

    /// The tensor `key`.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Tensor> {
        self.tensors.get(key)
    }

    /// Whether every number is finite.
    ///
    /// # Errors
    /// The network library's.
    pub fn are_finite(&self) -> Result<bool, TchError> {
        for tensor in self.tensors.values() {
            if tensor
                .f_sum(Kind::Double)?
                .f_isfinite()?
                .f_int64_value(&[])?
                == 0
            {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::{Init, ParameterError, ParameterSource};
    use std::collections::BTreeMap;
    use tch::{Device, Kind, Tensor};

    #[test]
    fn same_seed_and_key_give_same_bits() {
        let draw = |seed| {
            let mut source = ParameterSource::seeded(seed, Device::Cpu);
            let tensor = source
                .trainable("a.weight", &[3, 4], &Init::Normal(1.0))
                .unwrap();
            Vec::<f32>::try_from(tensor.flatten(0, -1)).unwrap()
        };
        assert_eq!(draw(5), draw(5));
        assert_ne!(draw(5), draw(6));
    }

    #[test]
    fn misfits_are_named() {
        let given = BTreeMap::from([(
            "a".to_owned(),
            Tensor::zeros([2], (Kind::Float, Device::Cpu)),
        )]);
        let mut source = ParameterSource::given(given);
        let missing = source.fixed("b", &[2], &Init::Constant(0.0)).unwrap_err();
        assert!(matches!(missing, ParameterError::Missing { key } if key == "b"));
        let shape = source.fixed("a", &[3], &Init::Constant(0.0)).unwrap_err();
        assert!(matches!(shape, ParameterError::Shape { actual, .. } if actual == [2]));
        assert!(
            matches!(source.finish().unwrap_err(), ParameterError::Unexpected { key } if key == "a")
        );
    }
}
