//! What an ACT-PC network is made of: an ACT transformer, and how points become its tokens.

use serde::{Deserialize, Serialize};

use crate::act::{ActConfig, ActPreset, ActionError};

/// A named network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActPcPreset {
    /// ACT as published, with point tokens instead of image tokens.
    Paper,
    /// PointCloudMatters' values: more points and tokens, narrow feed-forward layers, squared
    /// errors.
    PointCloudMatters,
    /// For quick work: half the width, chunks of 50 steps, few tokens.
    Small,
}

/// One ACT-PC network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActPcConfig {
    /// The transformer, its latent and its chunk. The cameras are those whose depth makes the
    /// cloud; the size of their colour images does not matter.
    pub act: ActConfig,
    /// Points in the cloud.
    pub points: i64,
    /// Tokens: centres that are chosen among the points. The cost of attention grows with their
    /// square.
    pub tokens: i64,
    /// Points around each centre that its token tells of.
    pub neighbours: i64,
    /// Whether tokens are made before the features of the points instead of from them
    /// (`pre_sample`).
    ///
    /// Then PointNet sees a group's maximum instead of single points, and `dim_model` must be its
    /// width.
    pub pre_sample: bool,
    /// What the loss counts of an action's error.
    pub action_error: ActionError,
}

impl ActPcConfig {
    /// The network of `preset` for the cloud of `cameras`, feature names.
    #[must_use]
    pub fn preset(preset: ActPcPreset, cameras: &[String]) -> Self {
        let paper = Self {
            act: ActConfig::preset(ActPreset::Paper, cameras),
            points: 2048,
            tokens: 512,
            neighbours: 16,
            pre_sample: false,
            action_error: ActionError::Absolute,
        };
        match preset {
            ActPcPreset::Paper => paper,
            ActPcPreset::PointCloudMatters => Self {
                act: ActConfig {
                    dim_feedforward: 32,
                    ..paper.act
                },
                points: 8192,
                tokens: 2048,
                action_error: ActionError::Squared,
                ..paper
            },
            ActPcPreset::Small => Self {
                act: ActConfig::preset(ActPreset::Small, cameras),
                points: 1024,
                tokens: 256,
                ..paper
            },
        }
    }

    /// What makes this configuration impossible to build, if anything does.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        let sizes = [
            ("points", self.points, 1, 1 << 20),
            ("tokens", self.tokens, 1, self.points),
            ("neighbours", self.neighbours, 1, self.points),
        ];
        for (name, value, low, high) in sizes {
            if !(low..=high).contains(&value) {
                return Some(format!("{name} = {value} is outside [{low}, {high}]"));
            }
        }
        let features = super::point_net::POINT_FEATURES;
        if self.pre_sample && self.act.dim_model != features {
            return Some(format!(
                "dim_model = {} is not {features}, which pre_sample needs",
                self.act.dim_model
            ));
        }
        self.act.defect()
    }
}

#[cfg(test)]
mod tests {
    use super::{ActPcConfig, ActPcPreset};

    #[test]
    fn every_preset_can_be_built() {
        let cameras = ["observation.images.endoscope".to_owned()];
        for preset in [
            ActPcPreset::Paper,
            ActPcPreset::PointCloudMatters,
            ActPcPreset::Small,
        ] {
            let defect = ActPcConfig::preset(preset, &cameras).defect();
            assert_eq!(defect, None, "{preset:?}");
        }
    }

    #[test]
    fn more_tokens_than_points_are_refused() {
        let cameras = ["observation.images.endoscope".to_owned()];
        let small = ActPcConfig::preset(ActPcPreset::Small, &cameras);
        let many = ActPcConfig {
            tokens: 1025,
            ..small.clone()
        };
        let defect = "tokens = 1025 is outside [1, 1024]";
        assert_eq!(many.defect().unwrap(), defect);
        let narrow = ActPcConfig {
            pre_sample: true,
            ..small
        };
        assert!(narrow.defect().unwrap().contains("pre_sample"));
    }
}
