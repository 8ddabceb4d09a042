//! The statistics that a frozen batch normalisation takes from pictures before a training from
//! scratch.
//!
//! Frozen statistics of 0 and 1 would normalise nothing; measured ones give every normalised
//! convolution zero mean and unit variance at the start, as batch normalisation does.

use std::collections::BTreeMap;

use tch::{TchError, Tensor};

use super::{Conv, NORM_EPS, ResNet18};

/// Mean and variance of each normalisation, by torchvision's key with `prefix` before it.
struct Measured<'a> {
    prefix: &'a str,
    /// `(channels)` each.
    found: BTreeMap<String, Tensor>,
}

impl Measured<'_> {
    /// `x` convolved and normalised by its own statistics over batch and pixels, which are kept
    /// under `key`.
    fn normalised(&mut self, conv: &Conv, key: &str, x: &Tensor) -> Result<Tensor, TchError> {
        let convolved = conv.convolved(x)?;
        let pixels = [0_i64, 2, 3].as_slice();
        let (variance, mean) = convolved.f_var_mean_dim(pixels, true, false)?;
        let per_channel = |statistic: &Tensor| statistic.f_view([1, -1, 1, 1]);
        let deviation = variance.f_add_scalar(NORM_EPS)?.f_sqrt()?;
        let normal = convolved
            .f_sub(&per_channel(&mean)?)?
            .f_div(&per_channel(&deviation)?)?;
        for (name, statistic) in [("running_mean", mean), ("running_var", variance)] {
            self.found
                .insert(format!("{}.{key}.{name}", self.prefix), statistic);
        }
        Ok(normal)
    }
}

impl ResNet18 {
    /// Mean and unbiased variance of every normalisation for `images` `(n, 3, h, w)`, by key, if
    /// each layer is normalised by its own: what training batch normalisation would note in one
    /// pass.
    pub(in crate::act) fn statistics(
        &self,
        prefix: &str,
        images: &Tensor,
    ) -> Result<BTreeMap<String, Tensor>, TchError> {
        let found = BTreeMap::new();
        let mut measured = Measured { prefix, found };
        let x = measured.normalised(&self.stem, "bn1", images)?;
        let x = x.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        let mut x = x.f_relu()?;
        for (index, block) in self.blocks.iter().enumerate() {
            let key = format!("layer{}.{}", index / 2 + 1, index % 2);
            let inner = measured.normalised(&block.first, &format!("{key}.bn1"), &x)?;
            let inner =
                measured.normalised(&block.second, &format!("{key}.bn2"), &inner.f_relu()?)?;
            let identity = match &block.downsample {
                Some(conv) => measured.normalised(conv, &format!("{key}.downsample.1"), &x)?,
                None => x.shallow_clone(),
            };
            x = inner.f_add(&identity)?.f_relu()?;
        }
        Ok(measured.found)
    }
}
