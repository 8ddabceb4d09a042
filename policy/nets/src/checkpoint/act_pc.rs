//! ACT-PC in a folder: as DP3, with its own network and without the variational encoder.
//!
//! Files: `config.json` (kind, network, cloud), `model.safetensors`, `statistics.safetensors` and
//! `trocar.json`; LeRobot has no such policy.

use std::path::Path;

use hal::chunk::CHUNK_STEPS_MAX;
use serde::{Deserialize, Serialize};
use tch::Device;

use super::clouds::{
    CloudStatistics, check_cloud, read_statistics, read_weights, write_statistics, write_weights,
};
use super::error::{Cause, CheckpointError};
use super::recipe::Recipe;
use super::tensors::Precision;
use super::{CONFIG, RECIPE, WEIGHTS, check_joints, load_recipe, processors, read_json};
use crate::act::VAE_PREFIX;
use crate::act_pc::{ActPc, ActPcConfig};
use crate::dimension::dimension;
use crate::parameters::ParameterSource;
use trocar_data::perception::CloudRecipe;
use trocar_data::relative_action::RELATIVE_ACTION_DIM;

/// What `config.json` says of the policy's kind.
pub const ACT_PC_TYPE: &str = "act_pc";

/// `config.json`; unknown keys are refused.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ActPcFile {
    #[serde(rename = "type")]
    kind: String,
    network: ActPcConfig,
    cloud: CloudRecipe,
}

/// An ACT-PC policy read from a folder.
#[derive(Debug)]
pub struct ActPcCheckpoint {
    /// The network, on the requested device; it cannot be trained further.
    pub network: ActPc,
    /// How its clouds are made.
    pub cloud: CloudRecipe,
    /// Statistics of what goes in and what comes out.
    pub statistics: CloudStatistics,
    /// `trocar.json`.
    pub recipe: Recipe,
}

/// Saves a policy into `folder`, which is made if it is not there, without what only training
/// needs.
///
/// # Errors
/// [`CheckpointError`] if a file cannot be written.
pub fn save_act_pc(
    folder: &Path,
    network: &ActPc,
    cloud: &CloudRecipe,
    statistics: &CloudStatistics,
    recipe: &Recipe,
    precision: Precision,
) -> Result<(), CheckpointError> {
    write_weights(folder, network.parameters(), VAE_PREFIX, precision)?;
    write_statistics(folder, statistics)?;
    let config = ActPcFile {
        kind: ACT_PC_TYPE.to_owned(),
        network: network.config().clone(),
        cloud: cloud.clone(),
    };
    processors::write_value(&folder.join(CONFIG), &config)?;
    processors::write_value(&folder.join(RECIPE), recipe)
}

/// Reads and checks the policy in `folder`.
///
/// # Errors
/// [`CheckpointError`] naming the file and what is wrong with it.
pub fn load_act_pc(folder: &Path, device: Device) -> Result<ActPcCheckpoint, CheckpointError> {
    let recipe_file = folder.join(RECIPE);
    let recipe = load_recipe(folder)?.ok_or_else(|| Cause::NoRecipe.in_file(&recipe_file))?;
    let file = folder.join(CONFIG);
    let text = read_json(&file)?;
    let config: ActPcFile =
        serde_json::from_str(&text).map_err(|error| Cause::Json(error).in_file(&file))?;
    check(&config, &recipe).map_err(|cause| cause.in_file(&file))?;
    let statistics = read_statistics(folder, recipe.arms * RELATIVE_ACTION_DIM)?;
    let weights = ParameterSource::given(read_weights(folder, device)?);
    let network = ActPc::new(config.network, weights)
        .map_err(|error| Cause::Parameter(error).in_file(&folder.join(WEIGHTS)))?;
    Ok(ActPcCheckpoint {
        network,
        cloud: config.cloud,
        statistics,
        recipe,
    })
}

/// Kind, network, cloud and recipe must make sense each and together, before any weight is read.
fn check(config: &ActPcFile, recipe: &Recipe) -> Result<(), Cause> {
    if config.kind != ACT_PC_TYPE {
        return Err(Cause::Unsupported {
            field: "type".to_owned(),
            value: config.kind.clone(),
            expected: ACT_PC_TYPE.to_owned(),
        });
    }
    let network = &config.network;
    if let Some(defect) = network.defect() {
        return Err(Cause::Config(defect));
    }
    check_cloud(&config.cloud, recipe)?;
    let (points, expected) = (config.cloud.points, network.points);
    if i64::try_from(points) != Ok(expected) {
        let defect = format!("cloud.points = {points}, the network's are {expected}");
        return Err(Cause::Inconsistent(defect));
    }
    let steps = network.act.chunk_size;
    if !(1..=dimension(CHUNK_STEPS_MAX)).contains(&steps) {
        let defect = format!("chunk_size = {steps} is outside [1, {CHUNK_STEPS_MAX}]");
        return Err(Cause::Config(defect));
    }
    super::check_query(recipe, steps)?;
    check_joints(recipe.arms, network.act.state_dim, network.act.action_dim)
}
