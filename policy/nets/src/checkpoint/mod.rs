//! Checkpoints: a folder as LeRobot 0.4 and later writes it, and our `trocar.json` beside it.
//!
//! `config.json` is the architecture, `model.safetensors` the weights, `policy_preprocessor.json`
//! and `policy_postprocessor.json` name the statistics. Nothing in the folder can run code.
//!
//! A checkpoint is refused at loading rather than wrong at run time: every tensor must be there and
//! used, of its shape and finite; configuration, statistics and recipe must agree; and a policy
//! runs once before it is handed out.

mod act_pc;
mod backbone;
#[cfg(test)]
mod cloud_refusal_tests;
mod clouds;
mod config_file;
mod dp3;
mod error;
#[cfg(test)]
mod processor_refusal_tests;
mod processors;
mod recipe;
#[cfg(test)]
mod refusal_tests;
pub(crate) mod tensors;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use hal::{ARM_NAMES, files};
use tch::Device;

pub use act_pc::{ACT_PC_TYPE, ActPcCheckpoint, load_act_pc, save_act_pc};
pub use backbone::BackboneWeights;
pub use clouds::CloudStatistics;
pub(crate) use dp3::history_steps as dp3_history_steps;
pub use dp3::{DP3_TYPE, Dp3Checkpoint, load_dp3, save_dp3};
pub use error::{Cause, CheckpointError};
pub use processors::FeatureStatistics;
pub use recipe::{
    AggregationName, DatasetPart, DatasetSummary, PolicyPreset, RECIPE_FORMAT, Recipe,
    RecommendedAggregation, RecordedCamera, Variants,
};
pub use tensors::Precision;

use crate::act::{Act, ActConfig, STATE_DIM, VAE_PREFIX};
use crate::parameters::ParameterSource;
use tensors::Plain;
use trocar_data::relative_action::{
    ABSOLUTE_REPRESENTATION, RELATIVE_ACTION_DIM, REPRESENTATION, action_dim,
};

/// Kind and architecture of the policy.
const CONFIG: &str = "config.json";
/// The file of the weights in a checkpoint's folder.
pub const WEIGHTS: &str = "model.safetensors";
/// What the actions mean, and provenance: a file that LeRobot does not have.
pub(crate) const RECIPE: &str = "trocar.json";

/// Whether the file called `name` in a checkpoint's folder is read when a policy is loaded.
#[must_use]
pub fn is_read(name: &str) -> bool {
    [CONFIG, WEIGHTS, RECIPE, clouds::STATISTICS].contains(&name)
        || ["policy_preprocessor", "policy_postprocessor"]
            .iter()
            .any(|processor| name.starts_with(processor))
}

/// Times between two steps of a chunk, ns, as the gate takes them: 1 kHz to 1 Hz.
const STEP_NS: std::ops::RangeInclusive<u64> = 1_000_000..=1_000_000_000;

/// How weights are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SaveOptions {
    /// Element type.
    pub precision: Precision,
    /// Whether to leave out the variational encoder, which only training needs.
    pub inference_only: bool,
}

/// Saves a policy into `folder`, which is made if it is not there.
///
/// # Errors
/// [`CheckpointError`] if a file cannot be written.
pub fn save(
    folder: &Path,
    act: &Act,
    statistics: &FeatureStatistics,
    recipe: &Recipe,
    options: SaveOptions,
) -> Result<(), CheckpointError> {
    std::fs::create_dir_all(folder).map_err(|error| Cause::io(error).in_file(folder))?;
    let weights_file = folder.join(WEIGHTS);
    let mut weights = BTreeMap::new();
    for (key, tensor) in act.parameters().iter() {
        if options.inference_only && key.starts_with(VAE_PREFIX) {
            continue;
        }
        let plain = Plain::from_tensor(tensor)
            .map_err(|error| Cause::Parameter(error.into()).in_file(&weights_file))?;
        weights.insert(key.to_owned(), plain);
    }
    tensors::write(&weights_file, &weights, options.precision)?;
    processors::write(folder, act.config(), statistics)?;
    processors::write_json(&folder.join(CONFIG), &config_file::write(act.config()))?;
    let file = folder.join(RECIPE);
    let recipe = serde_json::to_value(recipe).map_err(|error| Cause::Json(error).in_file(&file))?;
    processors::write_json(&file, &recipe)
}

/// A policy read from a folder.
#[derive(Debug)]
pub struct Checkpoint {
    /// The network, on the requested device.
    pub act: Act,
    /// Statistics of its inputs and outputs.
    pub statistics: FeatureStatistics,
    /// `trocar.json`; not there in folders of LeRobot's own.
    pub recipe: Option<Recipe>,
}

/// Reads and checks the policy in `folder`.
///
/// # Errors
/// [`CheckpointError`] naming the file and what is wrong with it.
pub fn load(folder: &Path, device: Device) -> Result<Checkpoint, CheckpointError> {
    let recipe = load_recipe(folder)?;
    let config_path = folder.join(CONFIG);
    let text = read_json(&config_path)?;
    let cameras: Option<Vec<String>> = recipe.as_ref().map(|recipe| {
        recipe
            .cameras
            .iter()
            .map(|camera| camera.feature.clone())
            .collect()
    });
    let variants = recipe
        .as_ref()
        .map(|recipe| recipe.variants)
        .unwrap_or_default();
    let config = config_file::read(&text, variants, cameras.as_deref())
        .map_err(|cause| cause.in_file(&config_path))?;
    check_widths(&config, recipe.as_ref()).map_err(|cause| cause.in_file(&config_path))?;
    if let Some(recipe) = &recipe {
        check_query(recipe, config.chunk_size).map_err(|cause| cause.in_file(&config_path))?;
    }
    let statistics = processors::read(folder, &config)?;
    let weights_path = folder.join(WEIGHTS);
    let in_weights = |cause: Cause| cause.in_file(&weights_path);
    let mut weights = BTreeMap::new();
    for (key, plain) in tensors::read(&weights_path)? {
        if !plain.values.iter().all(|value| value.is_finite()) {
            return Err(in_weights(Cause::NotFinite));
        }
        let tensor = plain
            .to_tensor(device)
            .map_err(|error| in_weights(Cause::Parameter(error.into())))?;
        weights.insert(key, tensor);
    }
    let act = Act::new(config, ParameterSource::given(weights))
        .map_err(|error| in_weights(Cause::Parameter(error)))?;
    Ok(Checkpoint {
        act,
        statistics,
        recipe,
    })
}

/// The network must have the inputs and outputs of the recipe's arms and kind of action; of one arm
/// without a recipe.
fn check_widths(config: &ActConfig, recipe: Option<&Recipe>) -> Result<(), Cause> {
    let arms = recipe.map_or(1, |recipe| recipe.arms);
    let of_arm = recipe.and_then(|recipe| action_dim(&recipe.action_representation));
    let of_arm = of_arm.unwrap_or(RELATIVE_ACTION_DIM);
    check_numbers(arms, config.state_dim, config.action_dim, of_arm)
}

/// State and relative action must have the numbers of so many arms.
fn check_joints(arms: usize, state_dim: i64, action_dim: i64) -> Result<(), Cause> {
    check_numbers(arms, state_dim, action_dim, RELATIVE_ACTION_DIM)
}

/// Widths of state and action against those of `arms` arms.
fn check_numbers(
    arms: usize,
    state_dim: i64,
    action_dim: i64,
    action_dim_of_arm: usize,
) -> Result<(), Cause> {
    let of_arms =
        |of_arm: i64| i64::try_from(arms).map_or(i64::MAX, |it| it.saturating_mul(of_arm));
    let action = of_arms(i64::try_from(action_dim_of_arm).unwrap_or(i64::MAX));
    for (feature, actual, expected) in [
        ("observation.state", state_dim, of_arms(STATE_DIM)),
        ("action", action_dim, action),
    ] {
        if actual != expected {
            return Err(Cause::JointCount {
                feature: feature.to_owned(),
                actual,
                arms,
                expected,
            });
        }
    }
    Ok(())
}

/// A chunk must last until the policy is asked again.
fn check_query(recipe: &Recipe, steps: i64) -> Result<(), Cause> {
    if i64::from(recipe.query_every_steps) <= steps {
        return Ok(());
    }
    Err(Cause::Inconsistent(format!(
        "query_every_steps = {} in {RECIPE}, but a chunk has {steps} steps",
        recipe.query_every_steps
    )))
}

/// The text of `file`, one of a checkpoint's in JSON.
fn read_json(file: &Path) -> Result<String, CheckpointError> {
    let text = files::read_text(file, "a checkpoint's JSON", files::JSON_SIZE_MAX);
    text.map_err(|error| Cause::io(error).in_file(file))
}

/// What was read; none if the file is not there.
fn there(read: Result<String, CheckpointError>) -> Result<Option<String>, CheckpointError> {
    match read {
        Err(error) if matches!(error.cause, Cause::Missing) => Ok(None),
        read => read.map(Some),
    }
}

/// The kind of the policy in `folder`, by its `config.json`; none if the file is not there or does
/// not say it.
///
/// # Errors
/// [`CheckpointError`] if the file cannot be read or is no JSON.
pub fn policy_type(folder: &Path) -> Result<Option<String>, CheckpointError> {
    let file = folder.join(CONFIG);
    let Some(text) = there(read_json(&file))? else {
        return Ok(None);
    };
    let config: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| Cause::Json(error).in_file(&file))?;
    Ok(config["type"].as_str().map(str::to_owned))
}

/// Networks from point clouds predict relative actions only.
fn check_relative(recipe: &Recipe) -> Result<(), Cause> {
    if recipe.action_representation == REPRESENTATION {
        return Ok(());
    }
    Err(Cause::Unsupported {
        field: "action_representation".to_owned(),
        value: recipe.action_representation.clone(),
        expected: REPRESENTATION.to_owned(),
    })
}

/// The recipe in `folder`; none if there is no `trocar.json`.
///
/// # Errors
/// [`CheckpointError`] naming what is wrong with the file.
pub fn load_recipe(folder: &Path) -> Result<Option<Recipe>, CheckpointError> {
    let file = folder.join(RECIPE);
    let Some(text) = there(read_json(&file))? else {
        return Ok(None);
    };
    let recipe: Recipe =
        serde_json::from_str(&text).map_err(|error| Cause::Json(error).in_file(&file))?;
    let unsupported = |field: &str, value: String, expected: String| {
        Err(Cause::Unsupported {
            field: field.to_owned(),
            value,
            expected,
        }
        .in_file(&file))
    };
    if recipe.format != RECIPE_FORMAT {
        return unsupported(
            "format",
            recipe.format.to_string(),
            RECIPE_FORMAT.to_string(),
        );
    }
    if action_dim(&recipe.action_representation).is_none() {
        return unsupported(
            "action_representation",
            recipe.action_representation,
            format!("{REPRESENTATION} or {ABSOLUTE_REPRESENTATION}"),
        );
    }
    if !(1..=ARM_NAMES.len()).contains(&recipe.arms) {
        let allowed = format!("1 to {}", ARM_NAMES.len());
        return unsupported("arms", recipe.arms.to_string(), allowed);
    }
    if !STEP_NS.contains(&recipe.step_ns) {
        let allowed = format!("{} to {}", STEP_NS.start(), STEP_NS.end());
        return unsupported("step_ns", recipe.step_ns.to_string(), allowed);
    }
    if recipe.query_every_steps == 0 {
        return unsupported("query_every_steps", "0".to_owned(), "1 or more".to_owned());
    }
    Ok(Some(recipe))
}
