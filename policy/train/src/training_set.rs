//! A dataset as tensors: images once decoded at the network's size, states, and chunks of relative
//! actions.
//!
//! States, chunks and padding of all frames are tensors on the device, a few hundred bytes to
//! kilobytes a frame; a batch is picked from them by index.

use std::ops::Range;

use hal::Pose;
use tch::{Device, TchError, Tensor};

use super::frame_images::FrameImages;
use super::transfer::send;
use super::{TrainError, TrainOptions};
use trocar_data::dataset::{Dataset, Episode};
use trocar_data::relative_action::{RELATIVE_ACTION_DIM, pose_from_numbers, relative_action};
use trocar_nets::act::ActConfig;
use trocar_nets::checkpoint::FeatureStatistics;
use trocar_nets::dimension::{dimension, length};
use trocar_nets::normalise::{ACTION_STD_MIN, STATE_STD_MIN, Statistics};

/// All frames, ready to be drawn from.
pub(super) struct TrainingSet {
    /// The images, on the device or in the host's memory.
    pub(super) images: FrameImages,
    /// `(frames, arms * 7)`, normalised.
    states: Tensor,
    /// `(frames, steps, arms * 7)`, normalised.
    chunks: Tensor,
    /// `(frames, steps)`, true past the end of the episode.
    is_pad: Tensor,
    /// Statistics of the trained frames.
    pub(super) statistics: FeatureStatistics,
    /// Frames that are trained on.
    pub(super) trained: Vec<usize>,
    /// Frames of the held-out episodes.
    pub(super) held_out: Vec<usize>,
}

/// A batch on the training device.
#[derive(Debug)]
pub(super) struct Batch {
    /// `(batch, cameras, height, width, 3)`, bytes.
    pub(super) images: Tensor,
    /// `(batch, arms * 7)`, normalised.
    pub(super) state: Tensor,
    /// `(batch, steps, arms * 7)`, normalised.
    pub(super) actions: Tensor,
    /// `(batch, steps)`, true past the end of the episode.
    pub(super) is_pad: Tensor,
}

impl TrainingSet {
    /// Reads `dataset` for the network `config`; the last episodes, the options' share of them, are
    /// held out, and take no part in the statistics. `on_read` hears how many frames are decoded.
    pub(super) fn new(
        dataset: &Dataset,
        config: &ActConfig,
        options: &TrainOptions,
        device: Device,
        on_read: &mut dyn FnMut(usize),
    ) -> Result<Self, TrainError> {
        let episodes = dataset.episodes();
        let (trained, held_out) = episode_split(episodes, options.validation_share)?;
        let steps = length(config.chunk_size);
        let rows: Vec<ChunkRow> = episodes
            .iter()
            .flat_map(|episode| {
                episode
                    .frames()
                    .map(|frame| chunk_of(dataset, &episode.frames(), frame, 0, steps))
            })
            .collect();
        let statistics = statistics(dataset, &trained, &rows).ok_or(TrainError::Empty)?;
        let FeatureStatistics { state, action } = &statistics;
        let width = RELATIVE_ACTION_DIM * dataset.arms();
        if let Some(defect) = state.defect(width).or_else(|| action.defect(width)) {
            return Err(TrainError::Dataset(defect));
        }
        let tensors = numbers(dataset, &rows, steps, [state, action], device)?;
        let [states, chunks, is_pad] = tensors;
        let place = (device, options.images_on_host);
        let images = FrameImages::new(dataset, config, options.threads, place, on_read)?;
        Ok(Self {
            images,
            states,
            chunks,
            is_pad,
            statistics,
            trained,
            held_out,
        })
    }

    /// Where all but the images is.
    pub(super) fn device(&self) -> Device {
        self.states.device()
    }

    /// The frames of [`index_tensor`] `indices`, with what [`FrameImages::sent`] of them.
    pub(super) fn batch(&self, indices: &Tensor, sent: Option<&Tensor>) -> Result<Batch, TchError> {
        Ok(Batch {
            images: self.images.batch(indices, sent)?,
            state: self.states.f_index_select(0, indices)?,
            actions: self.chunks.f_index_select(0, indices)?,
            is_pad: self.is_pad.f_index_select(0, indices)?,
        })
    }
}

/// Indices as a tensor on `device`, without waiting for work queued there.
pub(super) fn index_tensor(indices: &[usize], device: Device) -> Result<Tensor, TchError> {
    let indices: Vec<i64> = indices.iter().map(|&index| dimension(index)).collect();
    send(&Tensor::f_from_slice(&indices)?, device)
}

/// The frames of the episodes that are trained on, and those of the last ones, which are held out.
///
/// # Errors
/// [`TrainError::Dataset`] if some are to be held out and there is one episode alone.
pub(super) fn episode_split(
    episodes: &[Episode],
    validation_share: f64,
) -> Result<(Vec<usize>, Vec<usize>), TrainError> {
    if validation_share > 0.0 && episodes.len() == 1 {
        return Err(TrainError::Dataset(format!(
            "validation_share = {validation_share} of one episode: two or more are needed"
        )));
    }
    let (trained, held_out) = episodes.split_at(split_at(episodes.len(), validation_share));
    let frames = |episodes: &[Episode]| episodes.iter().flat_map(Episode::frames).collect();
    Ok((frames(trained), frames(held_out)))
}

/// How many of `episodes` are trained on: at least one, and not all if a share is to be held out.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share of a count is a count"
)]
#[expect(clippy::cast_precision_loss, reason = "episodes are few")]
fn split_at(episodes: usize, validation_share: f64) -> usize {
    let asked = (episodes as f64 * validation_share).round() as usize;
    let held_out = asked.max(usize::from(validation_share > 0.0));
    episodes.saturating_sub(held_out).max(1).min(episodes)
}

/// The actions that belong to one frame.
#[derive(Debug)]
pub(super) struct ChunkRow {
    /// As many a step as there are arms. `[steps, arms, 7]`, in SI units.
    actions: Vec<[f64; RELATIVE_ACTION_DIM]>,
    /// Steps that are not past the end of the episode.
    valid: usize,
}

/// The commands of `steps` frames, the first of them `before` frames before `frame`, each arm's
/// relative to its tip at `frame`; beyond either end of the episode the one there repeats.
///
/// Relative to the tip that was observed at `frame`, which is what the policy will know when it
/// answers.
pub(super) fn chunk_of(
    dataset: &Dataset,
    episode: &Range<usize>,
    frame: usize,
    before: usize,
    steps: usize,
) -> ChunkRow {
    let tip = |arm| pose_from_numbers(&dataset.tip_pose(frame, arm));
    let tips: Vec<Pose> = (0..dataset.arms()).map(tip).collect();
    let mut actions = Vec::with_capacity(steps * tips.len());
    for later in frame..frame + steps {
        let commanded = later.saturating_sub(before);
        let commanded = commanded.clamp(episode.start, episode.end - 1);
        for (arm, tip) in tips.iter().enumerate() {
            let [x, y, z, qx, qy, qz, qw, jaw] = dataset.action(commanded, arm);
            let target = pose_from_numbers(&[x, y, z, qx, qy, qz, qw]);
            actions.push(relative_action(tip, &target, jaw));
        }
    }
    ChunkRow {
        actions,
        valid: steps.min(episode.end + before - frame),
    }
}

/// Statistics of the frames `trained`, arm by arm; padding does not count. None without frames.
pub(super) fn statistics(
    dataset: &Dataset,
    trained: &[usize],
    rows: &[ChunkRow],
) -> Option<FeatureStatistics> {
    let arms = dataset.arms();
    let (mut states, mut actions) = (Vec::with_capacity(arms), Vec::with_capacity(arms));
    for arm in 0..arms {
        let state_of = |&frame: &usize| dataset.state(frame, arm).map(f64::from);
        states.push(Statistics::of(trained.iter().map(state_of), STATE_STD_MIN)?);
        let real = trained.iter().flat_map(|&frame| {
            let row = &rows[frame];
            let valid = &row.actions[..arms * row.valid];
            valid.iter().skip(arm).step_by(arms).copied()
        });
        actions.push(Statistics::of(real, ACTION_STD_MIN)?);
    }
    Some(FeatureStatistics {
        state: Statistics::joined(&states),
        action: Statistics::joined(&actions),
    })
}

/// States `(frames, numbers)` and actions, a frame a row, in SI units on the CPU.
#[expect(
    clippy::cast_possible_truncation,
    reason = "networks compute in single precision"
)]
pub(super) fn raw_numbers(
    dataset: &Dataset,
    rows: &[ChunkRow],
) -> Result<(Tensor, Tensor), TchError> {
    let arms = dataset.arms();
    let states: Vec<f32> = (0..rows.len())
        .flat_map(|frame| (0..arms).flat_map(move |arm| dataset.state(frame, arm)))
        .collect();
    let chunks: Vec<f32> = rows
        .iter()
        .flat_map(|row| row.actions.as_flattened())
        .map(|value| *value as f32)
        .collect();
    let frames = dimension(rows.len());
    Ok((
        Tensor::f_from_slice(&states)?.f_view([frames, -1])?,
        Tensor::f_from_slice(&chunks)?.f_view([frames, -1])?,
    ))
}

/// States `(frames, arms * 7)`, chunks `(frames, steps, arms * 7)`, both normalised, and
/// `(frames, steps)` that is true past the end of the episode; on `device`.
pub(super) fn numbers(
    dataset: &Dataset,
    rows: &[ChunkRow],
    steps: usize,
    [state, action]: [&Statistics; 2],
    device: Device,
) -> Result<[Tensor; 3], TchError> {
    let (states, chunks) = raw_numbers(dataset, rows)?;
    let is_pad: Vec<bool> = rows
        .iter()
        .flat_map(|row| (0..steps).map(|step| step >= row.valid))
        .collect();
    let frames = dimension(rows.len());
    let states = state.normaliser().apply(&states)?;
    let steps = dimension(steps);
    let chunks = action
        .normaliser()
        .apply(&chunks.f_view([frames, steps, -1])?)?;
    let is_pad = Tensor::f_from_slice(&is_pad)?.f_view([frames, steps])?;
    Ok([
        states.f_to_device(device)?,
        chunks.f_to_device(device)?,
        is_pad.f_to_device(device)?,
    ])
}

#[cfg(test)]
mod tests {
    use super::split_at;

    #[test]
    fn a_share_holds_out_at_least_one_episode_and_never_all() {
        for (episodes, share, trained) in [
            (10, 0.0, 10),
            (10, 0.2, 8),
            (2, 0.2, 1),
            (3, 0.01, 2),
            (2, 0.9, 1),
            (1, 0.0, 1),
        ] {
            assert_eq!(split_at(episodes, share), trained, "{share} of {episodes}");
        }
    }
}
