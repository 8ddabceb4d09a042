//! What a network's backbone starts from: random numbers (with statistics of the dataset's images,
//! if its normalisation is frozen), weights that were trained elsewhere, or an earlier run's state.

use std::collections::BTreeMap;

use tch::{Device, TchError, Tensor};

use super::flat::FlatParameters;
use super::{TrainError, TrainOptions, Trainer};
use trocar_nets::act::{Act, ActConfig, BACKBONE_PREFIX, BackboneNorm};
use trocar_nets::checkpoint::BackboneWeights;
use trocar_nets::parameters::ParameterSource;

impl Trainer {
    /// The same, but that the backbone of an ACT network, which must have frozen batch
    /// normalisation, starts from `weights` instead of random ones. A run that goes on has it all
    /// in its state. [`TrainOptions::for_trained_backbone`] has it move slower than the rest.
    #[must_use]
    pub fn starting_from(self, weights: BackboneWeights) -> Self {
        Self {
            backbone: Some(weights),
            ..self
        }
    }

    /// The network before its first step; of a run that goes on, with that run's statistics, which
    /// it takes in while it is built. `images` gives `(n, cameras, 3, height, width)`, normalised,
    /// on the CPU; it is called only where statistics are to be measured.
    pub(super) fn fresh(
        &self,
        config: &ActConfig,
        options: &TrainOptions,
        images: impl FnOnce() -> Result<Tensor, TchError>,
    ) -> Result<Act, TrainError> {
        let source = ParameterSource::seeded(options.seed, Device::Cpu);
        let drawn = Act::new(config.clone(), source)?;
        if config.backbone_norm == BackboneNorm::GroupNorm {
            return match &self.backbone {
                None => Ok(drawn),
                Some(_) => Err(TrainError::Options(
                    "a backbone with group normalisation can't start from one with frozen batch normalisation"
                        .to_owned(),
                )),
            };
        }
        let mut given = match (&self.backbone, &self.from) {
            (Some(weights), _) => weights
                .tensors()
                .iter()
                .map(|(key, it)| (key.clone(), it.shallow_clone()))
                .collect(),
            (None, Some(_)) => BTreeMap::new(),
            (None, None) => drawn.backbone_statistics(&images()?)?,
        };
        let mut tensors = BTreeMap::new();
        for (key, tensor) in drawn.parameters().iter() {
            let statistic =
                key.starts_with(BACKBONE_PREFIX) && !drawn.parameters().is_trainable(key);
            let given = given.remove(key);
            let start = match (&self.from, given) {
                (Some(state), _) if statistic => {
                    state.tensor(&FlatParameters::name_of_fixed(key), tensor)?
                }
                (_, given) => given.unwrap_or_else(|| tensor.shallow_clone()),
            };
            tensors.insert(key.to_owned(), start);
        }
        Ok(Act::new(config.clone(), ParameterSource::given(tensors))?)
    }
}
