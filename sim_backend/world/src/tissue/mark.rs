//! The mark that says where to grasp: a point of the material near the free edge, drawn by seed.

use hal::config::{ConfigError, Source};

use super::config::{MarkConfig, TissueConfig};
use crate::rng::Rng;

impl MarkConfig {
    /// Material coordinates (on the sheet's grid) of the mark of the episode `seed`, m.
    #[must_use]
    pub fn draw(&self, seed: u64, tissue: &TissueConfig) -> [f64; 2] {
        let mut rng = Rng::stream(seed, "mark");
        let along = rng.range(-0.5 * self.span_m, 0.5 * self.span_m);
        [
            0.5 * tissue.length_m + along,
            tissue.grid_depth_m() - self.inset_m,
        ]
    }

    /// Checks the ranges of a mark read from `source` at the dotted `key`.
    pub(super) fn check(
        &self,
        source: &Source,
        key: &str,
        tissue: &TissueConfig,
    ) -> Result<(), ConfigError> {
        source.check_range(&format!("{key}.span_m"), self.span_m, 0.0, tissue.length_m)?;
        source.check_range(
            &format!("{key}.inset_m"),
            self.inset_m,
            0.0,
            0.5 * tissue.depth_m,
        )
    }
}
