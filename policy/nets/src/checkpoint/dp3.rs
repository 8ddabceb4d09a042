//! DP3 in a folder: `config.json` with the network and how its clouds are made, weights, limits,
//! and `trocar.json`.
//!
//! The statistics' least and greatest values become [`LimitsNormaliser`]s; means and deviations are
//! kept as for the other policies and not used.

use std::collections::BTreeMap;
use std::path::Path;

use hal::chunk::CHUNK_STEPS_MAX;
use serde::{Deserialize, Serialize};
use tch::Device;

use super::clouds::{
    CloudStatistics, read_statistics, read_weights, write_statistics, write_weights,
};
use super::error::{Cause, CheckpointError};
use super::recipe::Recipe;
use super::tensors::Precision;
use super::{CONFIG, RECIPE, load_recipe, processors, read_json};
use crate::dimension::{dimension, length};
use crate::dp3::{Dp3, Dp3Config, LimitsNormaliser};
use crate::parameters::ParameterSource;
use trocar_data::perception::CloudRecipe;
use trocar_data::relative_action::RELATIVE_ACTION_DIM;

/// What `config.json` says of the policy's kind.
pub const DP3_TYPE: &str = "dp3";

/// `config.json`; unknown keys are refused.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Dp3File {
    #[serde(rename = "type")]
    kind: String,
    network: Dp3Config,
    cloud: CloudRecipe,
}

/// A DP3 policy read from a folder.
#[derive(Debug)]
pub struct Dp3Checkpoint {
    /// The network, on the requested device.
    pub dp3: Dp3,
    /// How its clouds are made.
    pub cloud: CloudRecipe,
    /// Limits of the points, on the CPU, as are the others.
    pub points: LimitsNormaliser,
    /// Of the state.
    pub state: LimitsNormaliser,
    /// Of the relative actions.
    pub action: LimitsNormaliser,
    /// `trocar.json`.
    pub recipe: Recipe,
}

/// Saves a policy into `folder`, which is made if it is not there.
///
/// # Errors
/// [`CheckpointError`] if a file cannot be written.
pub fn save_dp3(
    folder: &Path,
    dp3: &Dp3,
    cloud: &CloudRecipe,
    statistics: &CloudStatistics,
    recipe: &Recipe,
    precision: Precision,
) -> Result<(), CheckpointError> {
    write_weights(folder, dp3.parameters(), "", precision)?;
    write_statistics(folder, statistics)?;
    let config = Dp3File {
        kind: DP3_TYPE.to_owned(),
        network: dp3.config().clone(),
        cloud: cloud.clone(),
    };
    processors::write_value(&folder.join(CONFIG), &config)?;
    processors::write_value(&folder.join(RECIPE), recipe)
}

/// Reads and checks the policy in `folder`.
///
/// # Errors
/// [`CheckpointError`] naming the file and what is wrong with it.
pub fn load_dp3(folder: &Path, device: Device) -> Result<Dp3Checkpoint, CheckpointError> {
    let recipe_file = folder.join(RECIPE);
    let recipe = load_recipe(folder)?.ok_or_else(|| Cause::NoRecipe.in_file(&recipe_file))?;
    let config = read_config(folder, &recipe)?;
    let statistics = read_statistics(folder, recipe.arms * RELATIVE_ACTION_DIM)?;
    let limits = |feature: &str, [min, max]: [&[f32]; 2]| {
        LimitsNormaliser::new(min, max).map_err(|error| {
            Cause::Statistics {
                feature: feature.to_owned(),
                defect: error.to_string(),
            }
            .in_file(folder)
        })
    };
    let CloudStatistics {
        state,
        action,
        points,
    } = &statistics;
    let weights: BTreeMap<_, _> = read_weights(folder, device)?;
    let dp3 = Dp3::new(config.network, ParameterSource::given(weights))
        .map_err(|error| Cause::Parameter(error).in_file(&folder.join(super::WEIGHTS)))?;
    Ok(Dp3Checkpoint {
        points: limits("observation.points", [&points[0], &points[1]])?,
        state: limits("observation.state", [&state.min, &state.max])?,
        action: limits("action", [&action.min, &action.max])?,
        dp3,
        cloud: config.cloud,
        recipe,
    })
}

/// The policy steps before the newest observation in which the policy in `folder`, of this
/// `recipe`, wants to have observed.
pub(crate) fn history_steps(folder: &Path, recipe: &Recipe) -> Result<u64, CheckpointError> {
    let observations = read_config(folder, recipe)?.network.n_obs_steps;
    Ok(recipe.policy_steps_before(length(observations)))
}

/// `config.json`, checked against the recipe.
fn read_config(folder: &Path, recipe: &Recipe) -> Result<Dp3File, CheckpointError> {
    let file = folder.join(CONFIG);
    let text = read_json(&file)?;
    let config: Dp3File =
        serde_json::from_str(&text).map_err(|error| Cause::Json(error).in_file(&file))?;
    check(&config, recipe).map_err(|cause| cause.in_file(&file))?;
    Ok(config)
}

/// A chunk's usable steps are `horizon - n_obs_steps + 1`, from the newest observation on.
fn check(config: &Dp3File, recipe: &Recipe) -> Result<(), Cause> {
    if config.kind != DP3_TYPE {
        return Err(Cause::Unsupported {
            field: "type".to_owned(),
            value: config.kind.clone(),
            expected: DP3_TYPE.to_owned(),
        });
    }
    let network = &config.network;
    if let Some(defect) = network.defect() {
        return Err(Cause::Config(defect));
    }
    super::clouds::check_cloud(&config.cloud, recipe)?;
    let steps = network.horizon - network.n_obs_steps + 1;
    if !(1..=dimension(CHUNK_STEPS_MAX)).contains(&steps) {
        let defect = format!("{steps} steps of a chunk are outside [1, {CHUNK_STEPS_MAX}]");
        return Err(Cause::Config(defect));
    }
    super::check_query(recipe, steps)?;
    super::check_joints(recipe.arms, network.state_dim, network.action_dim)
}
