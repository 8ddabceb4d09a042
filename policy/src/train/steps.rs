//! The steps of a run, whatever the network: batches, optimiser, loss curve, end when the loss is NaN.

use tch::{Kind, TchError, Tensor};

use super::curve::{CurveRow, LossCurve};
use super::flat::FlatParameters;
use super::frame_order::FrameOrder;
use super::options::TrainOptions;
use super::{Progress, TrainError};
use crate::rng::SplitMix64;

/// A network in training, with the data that it learns from.
pub(super) trait Learner {
    /// What the step after the next one is going to be about, so that it can be fetched meanwhile.
    fn announce(&self, _frames: &[usize]) {}

    /// The loss over `frames`, and its two parts for the curve: error of the actions, divergence.
    fn losses(&self, frames: &[usize], random: &mut SplitMix64) -> Result<Losses, TchError>;

    /// Mean absolute error of the normalised actions over `frames`, as inference sees them.
    fn error(&self, frames: &[usize]) -> Result<f64, TchError>;
}

/// What a step minimises, and its parts.
pub(super) struct Losses {
    pub(super) total: Tensor,
    pub(super) l1: Tensor,
    pub(super) kl: Tensor,
}

/// The frames trained on, and those held out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Split<'a> {
    pub(super) trained: &'a [usize],
    pub(super) held_out: &'a [usize],
}

/// Takes all steps of the run; `on_progress` hears of every row of the loss curve.
pub(super) fn all_steps(
    learner: &dyn Learner,
    options: &TrainOptions,
    split: Split<'_>,
    flat: &mut FlatParameters,
    on_progress: &mut dyn FnMut(&Progress),
) -> Result<LossCurve, TrainError> {
    let mut shuffle = SplitMix64::named("train", options.seed);
    let mut random = SplitMix64::named("train/augment", options.seed);
    let mut order = FrameOrder::new(split.trained);
    let mut curve = LossCurve::default();
    let mut since_row = Vec::new();
    let mut next = order.next(options.batch, &mut shuffle);
    for step in 0..options.steps {
        let frames = next;
        next = order.next(options.batch, &mut shuffle);
        learner.announce(&next);
        let factor = options.lr_factor(step);
        let losses = learner.losses(&frames, &mut random)?;
        let lr = [options.lr_backbone * factor, options.lr * factor];
        let norm = flat.step(&losses.total, lr, options)?;
        let Losses { total, l1, kl } = losses;
        let parts = [total.f_detach()?, l1.f_detach()?, kl.f_detach()?, norm];
        // Not yet waited for.
        since_row.push(Tensor::f_stack(&parts, 0)?);
        let done = step + 1;
        if done.is_multiple_of(options.log_every) || done == options.steps {
            let means = Tensor::f_stack(&since_row, 0)?;
            let means = means.f_mean_dim([0].as_slice(), false, Kind::Double)?;
            let means = Vec::<f64>::try_from(&means)?;
            since_row.clear();
            let [loss, l1, kl, gradient_norm] = [means[0], means[1], means[2], means[3]];
            if !(loss.is_finite() && gradient_norm.is_finite()) {
                return Err(TrainError::Diverged { step: done, loss });
            }
            let row = CurveRow {
                step: done,
                loss,
                l1,
                kl,
                gradient_norm,
                lr: options.lr * factor,
                validation_l1: validate(learner, split.held_out, options.batch)?,
            };
            curve.rows.push(row);
            on_progress(&Progress::Row {
                steps: options.steps,
                row,
            });
        }
    }
    Ok(curve)
}

/// Mean absolute error of held-out frames, normalised; none without such frames. At most 256 frames, evenly spread, by
/// the weights as they are.
fn validate(
    learner: &dyn Learner,
    held_out: &[usize],
    batch: usize,
) -> Result<Option<f64>, TchError> {
    if held_out.is_empty() {
        return Ok(None);
    }
    let stride = held_out.len().div_ceil(256);
    let frames: Vec<usize> = held_out.iter().copied().step_by(stride).collect();
    tch::no_grad(|| {
        let (mut sum, mut parts) = (0.0, 0.0);
        for frames in frames.chunks(batch) {
            sum += learner.error(frames)?;
            parts += 1.0;
        }
        Ok(Some(sum / parts))
    })
}
