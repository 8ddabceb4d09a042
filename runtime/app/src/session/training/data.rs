//! What a training learns from: a dataset, or several as one.

use trocar_data::dataset::Dataset;
use trocar_nets::checkpoint::{DatasetPart, DatasetSummary};

use super::options::{CameraChoice, NetworkChoice, TrainingOptions};
use crate::session::SessionError;

/// The datasets, as the network sees them.
///
/// # Errors
/// [`SessionError::BadArgument`] of cameras that the first has not; those of
/// [`Dataset::open_joined`].
pub(super) fn open(options: &TrainingOptions) -> Result<Dataset, SessionError> {
    let (data, choice) = (&options.data, &options.cameras);
    let chosen = match data.first() {
        // All the cameras of the first, and none of the others has more.
        Some(_) if *choice == CameraChoice::Multi => None,
        Some(first) => {
            let chosen = choice.among(&Dataset::cameras_in(first)?);
            Some(chosen.map_err(|defect| {
                SessionError::BadArgument(format!("--cameras, {}: {defect}", first.display()))
            })?)
        }
        None => None,
    };
    let depth = options.network != NetworkChoice::Act;
    let joined = Dataset::open_joined(data, options.episodes, chosen.as_deref(), depth);
    Ok(joined?)
}

/// What is learned from, a line each: of several datasets each, then the whole.
pub(super) fn described(dataset: &Dataset) -> Vec<String> {
    let parts = parts(dataset).into_iter().map(|part| {
        let DatasetPart {
            folder,
            task,
            episodes,
            frames,
        } = part;
        format!("{folder}: {task}, {episodes} episodes, {frames} frames")
    });
    let (episodes, frames) = (dataset.episodes().len(), dataset.len());
    let whole = format!("{episodes} episodes, {frames} frames");
    parts.chain([whole]).collect()
}

/// What a checkpoint says of it.
pub(super) fn summary(dataset: &Dataset) -> DatasetSummary {
    DatasetSummary {
        task: dataset.task().to_owned(),
        episodes: dataset.episodes().len(),
        frames: dataset.len(),
        fps: dataset.fps(),
        parts: parts(dataset),
    }
}

/// The datasets, if there are several.
fn parts(dataset: &Dataset) -> Vec<DatasetPart> {
    let parts = dataset.parts();
    let several = parts.iter().filter(|_| parts.len() > 1);
    several
        .map(|part| DatasetPart {
            folder: part.dir.display().to_string(),
            task: part.task.clone(),
            episodes: part.episodes,
            frames: part.frames,
        })
        .collect()
}
