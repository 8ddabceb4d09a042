//! LeRobot's processor files: the normaliser before the network, the un-normaliser after it, and
//! their statistics.
//!
//! LeRobot keeps normalisation outside of the network, in pipelines of named steps; each step's
//! tensors are in a safetensors file that the JSON names. Of a pipeline only the normaliser's step
//! is done here; one that would rename features is refused.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use super::config_file::{features, normalisation};
use super::error::{Cause, CheckpointError};
use super::tensors::{self, Plain, Precision, replace};
use crate::act::ActConfig;
use crate::dimension::length;
use crate::normalise::{EPS, IMAGENET_MEAN, IMAGENET_STD, Statistics};

/// The pipeline before the network.
const PREPROCESSOR: &str = "policy_preprocessor.json";
/// The pipeline after it.
const POSTPROCESSOR: &str = "policy_postprocessor.json";
/// Statistics of inputs and actions, by the name that LeRobot's number of steps gives.
const BEFORE: &str = "policy_preprocessor_step_3_normalizer_processor.safetensors";
/// Statistics of actions alone.
const AFTER: &str = "policy_postprocessor_step_0_unnormalizer_processor.safetensors";

/// Statistics of what goes in and what comes out.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureStatistics {
    /// Of `observation.state`.
    pub state: Statistics,
    /// Of the relative actions.
    pub action: Statistics,
}

/// Writes both processors and their statistics into `folder`.
pub(super) fn write(
    folder: &Path,
    config: &ActConfig,
    statistics: &FeatureStatistics,
) -> Result<(), CheckpointError> {
    let [inputs, outputs] = features(config);
    let mut all = inputs.clone();
    all.extend(outputs.clone());
    let norm =
        |features: Value| json!({"eps": EPS, "features": features, "norm_map": normalisation()});
    let device = json!({"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": null}});
    let before = json!({"name": "policy_preprocessor", "steps": [
        {"registry_name": "rename_observations_processor", "config": {"rename_map": {}}},
        {"registry_name": "to_batch_processor", "config": {}},
        device,
        {"registry_name": "normalizer_processor", "config": norm(json!(all)), "state_file": BEFORE},
    ]});
    let after = json!({"name": "policy_postprocessor", "steps": [
        {"registry_name": "unnormalizer_processor", "config": norm(json!(outputs)), "state_file": AFTER},
        device,
    ]});
    write_json(&folder.join(PREPROCESSOR), &before)?;
    write_json(&folder.join(POSTPROCESSOR), &after)?;
    let mut values = BTreeMap::new();
    insert(&mut values, "action", &statistics.action);
    tensors::write(&folder.join(AFTER), &values, Precision::F32)?;
    insert(&mut values, "observation.state", &statistics.state);
    for camera in &config.cameras {
        for (name, numbers) in [("mean", IMAGENET_MEAN), ("std", IMAGENET_STD)] {
            let plain = Plain {
                shape: vec![3, 1, 1],
                values: numbers.to_vec(),
            };
            values.insert(format!("{camera}.{name}"), plain);
        }
    }
    tensors::write(&folder.join(BEFORE), &values, Precision::F32)
}

/// Writes anything that can be JSON to `file`.
pub(super) fn write_value(
    file: &Path,
    value: &impl serde::Serialize,
) -> Result<(), CheckpointError> {
    let value = serde_json::to_value(value).map_err(|error| Cause::Json(error).in_file(file))?;
    write_json(file, &value)
}

/// Writes `value` to `file` for people to read.
pub(super) fn write_json(file: &Path, value: &Value) -> Result<(), CheckpointError> {
    let mut text =
        serde_json::to_string_pretty(value).map_err(|error| Cause::Json(error).in_file(file))?;
    text.push('\n');
    replace(file, text.as_bytes())
}

/// Adds `FEATURE.mean`, `.std`, `.min` and `.max`; a part that is empty is left out.
pub(super) fn insert(values: &mut BTreeMap<String, Plain>, feature: &str, statistics: &Statistics) {
    let parts = [
        ("mean", &statistics.mean),
        ("std", &statistics.std),
        ("min", &statistics.min),
        ("max", &statistics.max),
    ];
    for (name, numbers) in parts {
        if !numbers.is_empty() {
            let plain = Plain {
                shape: vec![numbers.len()],
                values: numbers.clone(),
            };
            values.insert(format!("{feature}.{name}"), plain);
        }
    }
}

/// Reads and checks the statistics that the processors in `folder` name.
pub(super) fn read(
    folder: &Path,
    config: &ActConfig,
) -> Result<FeatureStatistics, CheckpointError> {
    let (before_file, before) = state_of(folder, PREPROCESSOR, "normalizer_processor", config)?;
    let (after_file, after) = state_of(folder, POSTPROCESSOR, "unnormalizer_processor", config)?;
    for camera in &config.cameras {
        check_image(&before, camera).map_err(|cause| cause.in_file(&before_file))?;
    }
    let state = statistics(&before, "observation.state", config.state_dim);
    let action = statistics(&after, "action", config.action_dim);
    Ok(FeatureStatistics {
        state: state.map_err(|cause| cause.in_file(&before_file))?,
        action: action.map_err(|cause| cause.in_file(&after_file))?,
    })
}

/// The statistics' file, and its tensors by key.
type StateFile = (std::path::PathBuf, BTreeMap<String, Plain>);

/// The statistics file of the step `registry_name` in the processor file `name`, which must do what
/// is done here.
fn state_of(
    folder: &Path,
    name: &str,
    registry_name: &str,
    config: &ActConfig,
) -> Result<StateFile, CheckpointError> {
    let file = folder.join(name);
    let text = super::read_json(&file)?;
    let document: Value =
        serde_json::from_str(&text).map_err(|error| Cause::Json(error).in_file(&file))?;
    let steps = document["steps"].as_array();
    for step in steps.into_iter().flatten() {
        check_step(step, config).map_err(|cause| cause.in_file(&file))?;
    }
    let step = steps.and_then(|steps| {
        steps
            .iter()
            .find(|step| step["registry_name"] == registry_name)
    });
    let Some(state_name) = step.and_then(|step| step["state_file"].as_str()) else {
        return Err(
            Cause::Config(format!("there is no {registry_name} with a state file")).in_file(&file),
        );
    };
    // The name comes from the file: it must not lead out of the folder.
    if Path::new(state_name).file_name() != Some(state_name.as_ref()) {
        return Err(
            Cause::Config(format!("state file {state_name:?} is no plain name")).in_file(&file),
        );
    }
    let state_file = folder.join(state_name);
    let values = tensors::read(&state_file)?;
    Ok((state_file, values))
}

/// What LeRobot reads of a step must be what is done here: no features of other names, means and
/// deviations with the usual epsilon, shapes as in `config`.
fn check_step(step: &Value, config: &ActConfig) -> Result<(), Cause> {
    let of_step = &step["config"];
    let unsupported = |field: String, value: &Value, expected: &Value| Cause::Unsupported {
        field,
        value: value.to_string(),
        expected: expected.to_string(),
    };
    let renamed = &of_step["rename_map"];
    if renamed.as_object().is_some_and(|names| !names.is_empty()) {
        return Err(unsupported("rename_map".to_owned(), renamed, &json!({})));
    }
    let modes = of_step["norm_map"].as_object();
    for (kind, mode) in modes.into_iter().flatten() {
        let expected = &normalisation()[kind];
        if !expected.is_null() && mode != expected {
            return Err(unsupported(format!("norm_map.{kind}"), mode, expected));
        }
    }
    let eps = &of_step["eps"];
    if !eps.is_null() && eps.as_f64().is_none_or(|eps| (eps - EPS).abs() > 1e-12) {
        return Err(unsupported("eps".to_owned(), eps, &json!(EPS)));
    }
    check_shapes(&of_step["features"], config)
}

/// The features of a step must have the shapes that they have in `config`.
fn check_shapes(of_step: &Value, config: &ActConfig) -> Result<(), Cause> {
    for (name, feature) in features(config).into_iter().flatten() {
        let (found, expected) = (&of_step[&name]["shape"], feature.shape());
        if !found.is_null() && *found != json!(expected) {
            return Err(Cause::Inconsistent(format!(
                "{name} has shape {found}, but {expected:?} in config.json"
            )));
        }
    }
    Ok(())
}

/// Mean and deviation of `feature`, which must be there and usable for `dims` numbers; the limits
/// may be missing.
pub(super) fn statistics(
    values: &BTreeMap<String, Plain>,
    feature: &str,
    dims: i64,
) -> Result<Statistics, Cause> {
    let part = |name: &str| {
        values
            .get(&format!("{feature}.{name}"))
            .map(|plain| plain.values.clone())
    };
    let defect = |defect: String| Cause::Statistics {
        feature: feature.to_owned(),
        defect,
    };
    let missing = |name: &str| defect(format!("{name} is missing"));
    let found = Statistics {
        mean: part("mean").ok_or_else(|| missing("mean"))?,
        std: part("std").ok_or_else(|| missing("std"))?,
        min: part("min").unwrap_or_default(),
        max: part("max").unwrap_or_default(),
    };
    found
        .defect(length(dims))
        .map_or(Ok(found), |text| Err(defect(text)))
}

/// Images are normalised with ImageNet's statistics; a checkpoint with others would silently see
/// other colours.
fn check_image(values: &BTreeMap<String, Plain>, camera: &str) -> Result<(), Cause> {
    for (name, expected) in [("mean", IMAGENET_MEAN), ("std", IMAGENET_STD)] {
        let found = values
            .get(&format!("{camera}.{name}"))
            .map_or(&[][..], |plain| plain.values.as_slice());
        let same = found.len() == 3
            && found
                .iter()
                .zip(expected)
                .all(|(a, b)| (a - b).abs() < 1e-4);
        if !same {
            let defect = format!("{name} is {found:?}, not ImageNet's {expected:?}");
            return Err(Cause::Statistics {
                feature: camera.to_owned(),
                defect,
            });
        }
    }
    Ok(())
}
