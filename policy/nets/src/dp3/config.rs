//! What a DP3 network is made of: the published values, and the two sizes that were published.

use serde::{Deserialize, Serialize};

/// Width of the state's features, and of the layer before them.
pub(super) const STATE_FEATURES: i64 = 64;

/// A named network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dp3Preset {
    /// DP3: 255 million parameters.
    Dp3,
    /// SimpleDP3: narrower, one block instead of two at every length; 7 million parameters.
    Simple,
}

/// One DP3 network. Field names and defaults are the published ones where these have the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dp3Config {
    /// Steps that are predicted at once; a multiple of what the lengths shrink by. The first step
    /// is that of the oldest observation.
    pub horizon: i64,
    /// Observations that the network sees, the newest last.
    pub n_obs_steps: i64,
    /// Steps that published code executes. Here only the validation error in training is taken over
    /// them; a policy answers with all steps from the newest observation on.
    pub n_action_steps: i64,
    /// Features of the points, and as many of the state.
    pub encoder_output_dim: i64,
    /// Features that tell the diffusion's step; even.
    pub diffusion_step_embed_dim: i64,
    /// Channels at every length of the U-Net.
    pub down_dims: Vec<i64>,
    /// Steps that a convolution sees; odd.
    pub kernel_size: i64,
    /// Groups of the group normalisation; divides every one of `down_dims`.
    pub n_groups: i64,
    /// Residual blocks at every length.
    pub blocks: usize,
    /// Steps of the diffusion in training.
    pub num_train_timesteps: i64,
    /// Steps of the diffusion in inference.
    pub num_inference_steps: i64,
    /// Numbers in one state.
    pub state_dim: i64,
    /// Numbers in one action.
    pub action_dim: i64,
}

impl Dp3Config {
    /// The network of `preset` for the given inputs.
    #[must_use]
    pub fn preset(preset: Dp3Preset, state_dim: i64, action_dim: i64) -> Self {
        let (down_dims, blocks) = match preset {
            Dp3Preset::Dp3 => (vec![512, 1024, 2048], 2),
            Dp3Preset::Simple => (vec![128, 256, 384], 1),
        };
        Self {
            horizon: 16,
            n_obs_steps: 2,
            n_action_steps: 8,
            encoder_output_dim: 64,
            diffusion_step_embed_dim: 128,
            down_dims,
            kernel_size: 5,
            n_groups: 8,
            blocks,
            num_train_timesteps: 100,
            num_inference_steps: 10,
            state_dim,
            action_dim,
        }
    }

    /// Features of one observation: of its points, then of its state.
    #[must_use]
    pub const fn observation_features(&self) -> i64 {
        // The published width of the state's branch is fixed.
        self.encoder_output_dim + STATE_FEATURES
    }

    /// Features of all observations together.
    #[must_use]
    pub const fn condition_features(&self) -> i64 {
        self.n_obs_steps * self.observation_features()
    }

    /// What makes this configuration impossible to build, if anything does.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        self.range_defect()
            .or_else(|| self.width_defect())
            .or_else(|| self.horizon_defect())
    }

    /// The first size outside of its range: keys, values, least and greatest.
    fn range_defect(&self) -> Option<String> {
        let (steps, steps_max) = (self.num_inference_steps, self.num_train_timesteps);
        let embedding = self.diffusion_step_embed_dim;
        let ranges = [
            ("horizon", self.horizon, 1, 1024),
            ("n_obs_steps", self.n_obs_steps, 1, 64),
            ("n_action_steps", self.n_action_steps, 1, 1024),
            ("encoder_output_dim", self.encoder_output_dim, 1, 8192),
            ("diffusion_step_embed_dim", embedding, 4, 8192),
            ("kernel_size", self.kernel_size, 1, 63),
            ("n_groups", self.n_groups, 1, 1024),
            ("num_train_timesteps", steps_max, 2, 10_000),
            ("num_inference_steps", steps, 1, steps_max),
            ("state_dim", self.state_dim, 1, 1024),
            ("action_dim", self.action_dim, 1, 1024),
        ];
        let outside = |(_, value, low, high): &(&str, i64, i64, i64)| value < low || value > high;
        let found = ranges.into_iter().find(outside);
        found.map(|(name, value, low, high)| format!("{name} = {value} is outside [{low}, {high}]"))
    }

    /// What is wrong with blocks, channels, kernel or embedding, whose sizes are in their ranges.
    fn width_defect(&self) -> Option<String> {
        if !(1..=8).contains(&self.blocks) || !(1..=8).contains(&self.down_dims.len()) {
            return Some(format!(
                "{} blocks at {} lengths are outside [1, 8]",
                self.blocks,
                self.down_dims.len()
            ));
        }
        let odd_one = |&&width: &&i64| !(1..=16_384).contains(&width) || width % self.n_groups != 0;
        if let Some(width) = self.down_dims.iter().find(odd_one) {
            return Some(format!(
                "{width} channels are no multiple of n_groups = {} in [1, 16384]",
                self.n_groups
            ));
        }
        if self.kernel_size % 2 == 0 || self.diffusion_step_embed_dim % 2 != 0 {
            return Some(format!(
                "kernel_size = {} is not odd or diffusion_step_embed_dim = {} not even",
                self.kernel_size, self.diffusion_step_embed_dim
            ));
        }
        None
    }

    /// What is wrong with the horizon, which every length of the U-Net halves.
    fn horizon_defect(&self) -> Option<String> {
        let shrink = 1_i64 << (self.down_dims.len() - 1);
        if self.horizon % shrink != 0 {
            return Some(format!(
                "horizon = {} is no multiple of {shrink}",
                self.horizon
            ));
        }
        (self.n_obs_steps - 1 + self.n_action_steps > self.horizon).then(|| {
            format!(
                "n_action_steps = {} from step {} on go beyond horizon = {}",
                self.n_action_steps,
                self.n_obs_steps - 1,
                self.horizon
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Dp3Config, Dp3Preset};

    #[test]
    fn both_presets_can_be_built() {
        for preset in [Dp3Preset::Dp3, Dp3Preset::Simple] {
            assert_eq!(Dp3Config::preset(preset, 7, 7).defect(), None, "{preset:?}");
        }
    }

    #[test]
    fn impossible_networks_are_refused_by_name() {
        let good = Dp3Config::preset(Dp3Preset::Simple, 7, 7);
        let refused = |config: Dp3Config, what: &str| {
            let defect = config.defect().unwrap();
            assert!(defect.contains(what), "{defect}");
        };
        let horizon = 18;
        refused(
            Dp3Config {
                horizon,
                ..good.clone()
            },
            "horizon = 18",
        );
        let n_groups = 7;
        refused(
            Dp3Config {
                n_groups,
                ..good.clone()
            },
            "n_groups = 7",
        );
        let n_action_steps = 16;
        refused(
            Dp3Config {
                n_action_steps,
                ..good.clone()
            },
            "beyond horizon",
        );
        let num_inference_steps = 101;
        refused(
            Dp3Config {
                num_inference_steps,
                ..good.clone()
            },
            "outside [1, 100]",
        );
        let kernel_size = 4;
        refused(
            Dp3Config {
                kernel_size,
                ..good
            },
            "kernel_size = 4",
        );
    }
}
