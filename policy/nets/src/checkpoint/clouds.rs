//! What the checkpoints of all policies that see point clouds have in common: weights, statistics,
//! the cloud's recipe.

use std::collections::BTreeMap;
use std::path::Path;

use tch::{Device, Tensor};

use super::WEIGHTS;
use super::error::{Cause, CheckpointError};
use super::processors::{insert, statistics};
use super::recipe::Recipe;
use super::tensors::{self, Plain, Precision};
use crate::dimension::dimension;
use crate::normalise::Statistics;
use crate::parameters::Parameters;
use trocar_data::perception::{CloudRecipe, Point};

/// Keys `observation.state.*`, `action.*` (mean, std, min, max) and `observation.points.min` and
/// `.max`, all in single precision.
pub(super) const STATISTICS: &str = "statistics.safetensors";

/// Points that a cloud may have.
const POINTS_MAX: usize = 1 << 16;

/// Statistics of what goes in and what comes out.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudStatistics {
    /// Of `observation.state`.
    pub state: Statistics,
    /// Of the relative actions.
    pub action: Statistics,
    /// Least and greatest coordinates of the points, m.
    pub points: [Point; 2],
}

/// Writes what of `parameters` has not the beginning `left_out`; none has the empty one.
pub(super) fn write_weights(
    folder: &Path,
    parameters: &Parameters,
    left_out: &str,
    precision: Precision,
) -> Result<(), CheckpointError> {
    std::fs::create_dir_all(folder).map_err(|error| Cause::io(error).in_file(folder))?;
    let file = folder.join(WEIGHTS);
    let mut weights = BTreeMap::new();
    for (key, tensor) in parameters.iter() {
        if !left_out.is_empty() && key.starts_with(left_out) {
            continue;
        }
        let plain = Plain::from_tensor(tensor)
            .map_err(|error| Cause::Parameter(error.into()).in_file(&file))?;
        weights.insert(key.to_owned(), plain);
    }
    tensors::write(&file, &weights, precision)
}

/// The weights in `folder`, all finite, on `device`.
pub(super) fn read_weights(
    folder: &Path,
    device: Device,
) -> Result<BTreeMap<String, Tensor>, CheckpointError> {
    let file = folder.join(WEIGHTS);
    let mut weights = BTreeMap::new();
    for (key, plain) in tensors::read(&file)? {
        if !plain.values.iter().all(|value| value.is_finite()) {
            return Err(Cause::NotFinite.in_file(&file));
        }
        let tensor = plain
            .to_tensor(device)
            .map_err(|error| Cause::Parameter(error.into()).in_file(&file))?;
        weights.insert(key, tensor);
    }
    Ok(weights)
}

/// Writes [`STATISTICS`].
pub(super) fn write_statistics(
    folder: &Path,
    statistics: &CloudStatistics,
) -> Result<(), CheckpointError> {
    let mut values = BTreeMap::new();
    insert(&mut values, "observation.state", &statistics.state);
    insert(&mut values, "action", &statistics.action);
    for (name, corner) in ["min", "max"].into_iter().zip(statistics.points) {
        let plain = Plain {
            shape: vec![3],
            values: corner.to_vec(),
        };
        values.insert(format!("observation.points.{name}"), plain);
    }
    tensors::write(&folder.join(STATISTICS), &values, Precision::F32)
}

/// The statistics in `folder`, for `dims` numbers of state and of action.
pub(super) fn read_statistics(
    folder: &Path,
    dims: usize,
) -> Result<CloudStatistics, CheckpointError> {
    let file = folder.join(STATISTICS);
    let values = tensors::read(&file)?;
    let of = |feature: &str| {
        statistics(&values, feature, dimension(dims)).map_err(|cause| cause.in_file(&file))
    };
    let corner = |name: &str| corner(&values, name).map_err(|cause| cause.in_file(&file));
    Ok(CloudStatistics {
        state: of("observation.state")?,
        action: of("action")?,
        points: [corner("min")?, corner("max")?],
    })
}

/// The lowest or the highest coordinates of all points, m.
fn corner(values: &BTreeMap<String, Plain>, name: &str) -> Result<Point, Cause> {
    let found = values.get(&format!("observation.points.{name}"));
    let point = found.and_then(|plain| plain.values.as_slice().try_into().ok());
    point.ok_or_else(|| Cause::Statistics {
        feature: "observation.points".to_owned(),
        defect: format!("{name} is missing or not of three numbers"),
    })
}

/// What a checkpoint says of its clouds must make sense, and there must be a camera.
pub(super) fn check_cloud(cloud: &CloudRecipe, recipe: &Recipe) -> Result<(), Cause> {
    if !(1..=POINTS_MAX).contains(&cloud.points) {
        let defect = format!(
            "cloud.points = {} is outside [1, {POINTS_MAX}]",
            cloud.points
        );
        return Err(Cause::Config(defect));
    }
    super::check_relative(recipe)?;
    if recipe.cameras.is_empty() {
        let defect = "trocar.json lists no camera to take points from".to_owned();
        return Err(Cause::Inconsistent(defect));
    }
    Ok(())
}
